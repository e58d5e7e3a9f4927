# SPDX-License-Identifier: Apache-2.0
"""Scale from landmarks of known place: corners of a pressed cuboid, scratches, a ruled pattern."""

from __future__ import annotations

import cv2
import numpy as np

from taccel_lab.calibration.capture.folder import LandmarkCapture
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.scale.estimate import ScaleEstimate
from taccel_lab.calibration.shared_remarks import LABELS_OFF
from taccel_lab.errors import InputError

CLICK_SIGMA_PX = 1.0
"""How well a person marks a point, where the points do not show it themselves."""


def scale_from_landmarks(capture: LandmarkCapture, method: str = "landmarks") -> ScaleEstimate:
    """Scale in the middle of the landmarks, from the map that they define.

    A similarity with unequal axes from 3 points, a homography from 6.

    Raises:
        InputError: The points lie on a line.
    """
    points = np.array([[p.u_px, p.v_px, p.x_mm, p.y_mm] for p in capture.entry.points])
    uv, xy = points[:, :2], points[:, 2:]
    matrix, rms = fit_map(xy, uv, projective=len(points) >= 6)
    scale = scale_of_map(matrix, xy.mean(axis=0))
    noise = max(rms, CLICK_SIGMA_PX)
    # Each point moved by its noise: how the scale follows, by finite differences.
    variance = np.zeros(2)
    for i in range(len(uv)):
        for k in range(2):
            moved = uv.copy()
            moved[i, k] += 0.5
            up = scale_of_map(fit_map(xy, moved, projective=len(points) >= 6)[0], xy.mean(axis=0))
            variance += (2 * (up - scale) * noise) ** 2
    sigma = np.sqrt(variance)
    remarks = []
    if rms > 3 * CLICK_SIGMA_PX:
        how = f"{capture.frame.name}: {rms:.1f} px off the map that they define"
        figures = {"off": 1, "count": len(points), "how": how, "advice": "One of them is mistaken"}
        remarks.append(LABELS_OFF(what="landmarks", **figures))
    return ScaleEstimate(
        method,
        Estimate(float(scale[0]), float(sigma[0]), "mm/px"),
        Estimate(float(scale[1]), float(sigma[1]), "mm/px"),
        inputs={capture.frame.name: capture.frame.sha256},
        evidence={"points": len(points), "rms_px": rms},
        remarks=tuple(remarks),
    )


def fit_map(xy_mm: np.ndarray, uv_px: np.ndarray, *, projective: bool) -> tuple[np.ndarray, float]:
    """Homography [3, 3] from the plane [mm] to the image [px], affine unless ``projective``, and
    the root mean square of what it leaves.

    Raises:
        InputError: Points [n, 2] that lie on a line.
    """
    centred = xy_mm - xy_mm.mean(axis=0)
    spread = np.linalg.svd(centred, compute_uv=False)
    if len(xy_mm) < 3 or spread[1] < 1e-3 * spread[0]:
        raise InputError("landmarks on one line give no scale across it; at least 3 off a line")
    if projective:
        found, _ = cv2.findHomography(xy_mm, uv_px, 0)
        if found is None:
            raise InputError("the landmarks define no homography; check their coordinates")
        matrix = np.asarray(found)
    else:
        design = np.column_stack([xy_mm, np.ones(len(xy_mm))])
        rows, *_ = np.linalg.lstsq(design, uv_px, rcond=None)
        matrix = np.vstack([rows.T, [0.0, 0.0, 1.0]])
    mapped = np.column_stack([xy_mm, np.ones(len(xy_mm))]) @ matrix.T
    left = uv_px - mapped[:, :2] / mapped[:, 2:]
    freedom = max(2 * len(xy_mm) - (8 if projective else 6), 1)
    return matrix, float(np.sqrt(np.sum(left**2) * 2 / freedom / 2))


def scale_of_map(matrix: np.ndarray, at_mm: np.ndarray) -> np.ndarray:
    """mm/px along the image's x and y [2] at a point of the plane, of a homography to pixels."""
    h = np.asarray(matrix, dtype=np.float64)
    x, y = at_mm
    w = h[2] @ [x, y, 1.0]
    uv = h[:2] @ [x, y, 1.0] / w
    jacobian = (h[:2, :2] - np.outer(uv, h[2, :2])) / w
    if abs(np.linalg.det(jacobian)) < 1e-12:
        raise InputError("the map from millimetres to pixels is singular")
    # Lengths on the gel that one pixel along u, or along v, spans.
    inverse = np.linalg.inv(jacobian)
    return np.linalg.norm(inverse, axis=0)
