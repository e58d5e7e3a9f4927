# SPDX-License-Identifier: Apache-2.0
"""Scale from presses of a straight edge of known length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from taccel_lab.calibration.camera.board import hashes_by_name
from taccel_lab.calibration.capture.captures import Frame
from taccel_lab.calibration.capture.folder import EdgeCapture
from taccel_lab.calibration.capture.schema import LineEntry
from taccel_lab.calibration.remarks import TOO_FEW
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.scale.edge_line import EdgeLine, find_edge
from taccel_lab.calibration.scale.result import ScaleEstimate
from taccel_lab.errors import InputError
from taccel_lab.printable import counted
from taccel_lab.report.remark import Remark
from taccel_lab.robust_fit import spread_about_zero

SQUARE_SIGMA = 0.03
"""How far pixels are from square, as a share, where the edges do not tell: cameras have square
ones, but images are resized."""
LABEL_SIGMA_PX = 1.5
"""How well a person marks the end of an edge."""
_TOO_SHORT_SIGMAS = 4.0
"""An edge that lies this much below the others touched with a part of its length only."""


@dataclass(frozen=True)
class MeasuredEdge:
    """One press of an edge."""

    frame: Frame
    length_mm: float
    line: EdgeLine


def measure_edges(
    edges: Sequence[EdgeCapture], background: np.ndarray, mask: np.ndarray | None
) -> tuple[list[MeasuredEdge], list[str]]:
    """Edges found in their images, and the reasons of those that were not."""
    found, refused = [], []
    for edge in edges:
        try:
            line = find_edge(edge.frame.image(), background, mask=mask, name=edge.frame.source)
        except InputError as error:
            if edge.entry.line is None:
                refused.append(str(error))
                continue
            line = _labelled(edge.entry.line)
        found.append(MeasuredEdge(edge.frame, edge.entry.length_mm, line))
    return found, refused


def _labelled(label: LineEntry) -> EdgeLine:
    """The line that a person drew, for an edge that is not found in its image."""
    angle = np.radians(label.angle_deg)
    half = 0.5 * label.length_px * np.array([np.cos(angle), np.sin(angle)])
    middle = np.array([label.u_px, label.v_px])
    return EdgeLine(np.stack([middle - half, middle + half]), 2**0.5 * LABEL_SIGMA_PX, 0.0)


def scale_from_edges(
    measured: Sequence[MeasuredEdge], refused: Sequence[str] = ()
) -> ScaleEstimate:
    """Scale along x and y that gives all edges their length.

    ``length^2 = (du sx)^2 + (dv sy)^2``. An edge that was pressed at an angle touches with a part
    of its length only: those that are clearly shorter than the others are left out.

    Raises:
        InputError: No edge was found.
    """
    if not measured:
        raise InputError("no pressed edge was found:\n" + "\n".join(refused[:5]))
    vectors = np.array([edge.line.vector_px for edge in measured])
    wanted_mm = np.array([edge.length_mm for edge in measured])
    sigmas_px = np.array([edge.line.length_sigma_px for edge in measured])
    used = np.ones(len(measured), dtype=bool)
    while True:
        scale = _fit(vectors, wanted_mm, sigmas_px, used)
        left = wanted_mm - _lengths_mm(vectors, scale)
        noise = float(np.median(sigmas_px) * scale.mean() / 2)
        short = used & (left > _TOO_SHORT_SIGMAS * (spread_about_zero(left[used]) + noise))
        if not short.any() or used.sum() <= max(3, len(measured) // 2):
            break
        used[int(np.argmax(np.where(used, left, -np.inf)))] = False
    chosen = [edge for edge, ok in zip(measured, used, strict=True) if ok]
    # The law by which the jump decays beyond an end is the same for all: its error does not
    # average out.
    shared = float(np.mean([edge.line.systematic_px / edge.line.length_px for edge in chosen]))
    covariance = _covariance(vectors[used], sigmas_px[used], scale, left[used])
    covariance += np.outer(scale, scale) * shared**2
    sigma = np.sqrt(np.diag(covariance))
    return ScaleEstimate(
        "edge",
        Estimate(float(scale[0]), float(sigma[0]), "mm/px"),
        Estimate(float(scale[1]), float(sigma[1]), "mm/px"),
        inputs=hashes_by_name([edge.frame for edge in chosen]),
        evidence={
            "correlation": float(covariance[0, 1] / (sigma[0] * sigma[1])),
            "edges": [
                {
                    "name": edge.frame.source,
                    "ends_px": edge.line.ends_px.tolist(),
                    "length_px": edge.line.length_px,
                    "sigma_px": edge.line.length_sigma_px,
                    "angle_deg": edge.line.angle_deg,
                    "length_mm": edge.length_mm,
                    "residual_mm": float(residual),
                    "used": bool(ok),
                }
                for edge, residual, ok in zip(measured, left, used, strict=True)
            ],
            "edge_rms_mm": float(np.sqrt(np.mean(left[used] ** 2))),
        },
        remarks=tuple(_remarks(chosen)),
        refused=tuple(refused),
    )


def _lengths_mm(vectors: np.ndarray, scale: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors * scale, axis=1)


def _fit(
    vectors: np.ndarray, wanted_mm: np.ndarray, sigmas_px: np.ndarray, used: np.ndarray
) -> np.ndarray:
    """Scale along x and y, shape [2]."""
    first = float(np.median(wanted_mm / [np.linalg.norm(vector) for vector in vectors]))

    def residuals(x: np.ndarray) -> np.ndarray:
        scale = np.exp(x)
        short = wanted_mm - _lengths_mm(vectors, scale)
        short /= sigmas_px * np.sqrt(scale[0] * scale[1])
        return np.append(short[used], (x[1] - x[0]) / SQUARE_SIGMA)

    fit = least_squares(residuals, np.log([first, first]), loss="huber", f_scale=1.5)
    return np.exp(fit.x)


def _covariance(
    vectors: np.ndarray, sigmas_px: np.ndarray, scale: np.ndarray, left: np.ndarray
) -> np.ndarray:
    """Covariance of both scales, from the spread of the edges."""
    jacobian = vectors**2 * scale / _lengths_mm(vectors, scale)[:, None]
    count, stated = len(vectors), sigmas_px * float(scale.mean())
    excess = 1.0
    if count > 3:
        excess = max(1.0, float(np.mean((left / stated) ** 2) * count / (count - 2)))
    square = np.array([-1.0, 1.0]) / (SQUARE_SIGMA * float(scale.mean()))
    information = (jacobian / stated[:, None]).T @ (jacobian / stated[:, None]) / excess
    return np.linalg.inv(information + np.outer(square, square))


def _remarks(chosen: Sequence[MeasuredEdge]) -> list[Remark]:
    angles = np.radians([edge.line.angle_deg for edge in chosen])
    along = {"x": np.cos(angles) ** 2, "y": np.sin(angles) ** 2}
    lacking = [axis for axis, share in along.items() if share.max(initial=0.0) < 0.5]
    if len(chosen) >= 4 and not lacking:
        return []
    count = counted(len(chosen), "press", "presses")
    words = f", none along {' or '.join(lacking)}" if lacking else ""
    wanted = (
        "8 or more, along x and along y, tell both scales; without, pixels are taken to be square "
        f"within {SQUARE_SIGMA:.0%}"
    )
    return [TOO_FEW(found=f"{count} of the edge{words}", wanted=wanted)]
