# SPDX-License-Identifier: Apache-2.0
"""Scale, rectification and pose of the camera from views of a board that lies on the gel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from taccel_lab.calibration.camera import remarks
from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.gel_frame import GelFrame, gel_frame, scale_range
from taccel_lab.calibration.camera.intrinsics import Intrinsics
from taccel_lab.calibration.camera.plane_fit import (
    PlaneFit,
    choose_plane,
    fit_plane,
    fit_planes,
    plane_rotation,
)
from taccel_lab.calibration.camera.plane_models import CameraPose
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.robust_fit import slopes
from taccel_lab.calibration.shared_remarks import HELDOUT_ERROR
from taccel_lab.camera.refraction import FlatMedia
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.report.remark import Remark

MIN_POINTS = 8
DISTORTED = 0.02
"""Change of scale under the board from which on the image counts as distorted."""
MAX_SHEAR = 0.01
LARGE_ERROR_PITCHES = 0.05


@dataclass(frozen=True)
class PoseInGel:
    """Where the camera is in the gel frame."""

    fit: PlaneFit
    position_mm: tuple[float, float, float]
    position_sigma_mm: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    """gel_from_camera, quaternion x, y, z, w."""
    tilt_deg: float
    """Angle between the optical axis and the gel's normal."""
    refracted: bool


@dataclass(frozen=True)
class OnGel:
    """What boards on the gel tell."""

    fit: PlaneFit
    """The map from the gel to the image that is used."""
    frame: GelFrame
    grid: PixelGrid
    """Of the rectified image; where it is as large as the raw one, it holds for that too as far as
    it is not distorted."""
    center_px: tuple[float, float]
    """Raw pixel of the gel frame's origin."""
    views: tuple[BoardView, ...]
    fits: tuple[PlaneFit, ...]
    """All models compared."""
    pose: PoseInGel | None
    """The one that is used; None without a calibrated lens."""
    poses: tuple[PoseInGel, ...]
    """All that were fitted: with straight sight lines, then through the media if they are given."""
    scale_range: tuple[float, float]
    """Least and largest scale under the board, relative to its middle."""
    remarks: tuple[Remark, ...]

    def pixel_from_gel(self, xy_mm: np.ndarray) -> np.ndarray:
        """Raw pixels of gel points [mm], [n, 2] -> [n, 2]."""
        return self.fit.project(self.frame.board_from_gel(xy_mm))

    @property
    def points_in_gel_mm(self) -> np.ndarray:
        """The board's points in the gel frame, all views, shape [n, 2]."""
        board = self.fit.plane_points(self.views) - self.frame.origin_mm
        return board @ plane_rotation(self.frame.angle_rad)


def fit_on_gel(
    views: Sequence[BoardView],
    *,
    center_px: tuple[float, float] | None = None,
    tactile_px: tuple[int, int] | None = None,
    intrinsics: Intrinsics | None = None,
    media: FlatMedia | None = None,
) -> OnGel:
    """Fit the gel's face to boards that lie on it.

    Args:
        views: With known pitch; several are boards laid down at different places.
        center_px: Pixel of the gel frame's origin; the image's middle when None.
        tactile_px: Width and height of the rectified image, about that pixel, where it is cut out
            of the camera's own; None: as large as that.
        intrinsics: The camera's lens, of images of the same size; gives its pose too.
        media: What lies before the contact face z = 0, for the pose; sight lines are straight where
            that explains the board clearly better.

    Raises:
        InputError: No pitch, too few points, or intrinsics of other images.
    """
    for view in views:
        if view.pitch_mm is None:
            raise InputError(
                f"{view.source}: a board on the gel gives the scale only with pitch_mm, the "
                "distance of its points; state it in the manifest"
            )
        if len(view.index) < MIN_POINTS:
            raise InputError(
                f"{view.source}: {len(view.index)} points of the board are too few for a scale; "
                f"at least {MIN_POINTS}"
            )
    # The board with the most points comes first: the others are placed against it.
    views = sorted(views, key=lambda view: -len(view.index))
    size, pitch = views[0].size_px, float(views[0].pitch_mm or 1.0)
    if intrinsics is not None and intrinsics.size_px != size:
        raise InputError(
            f"the board on the gel was seen in images of {size[0]}x{size[1]} px, the views for "
            f"the lens are {intrinsics.size_px[0]}x{intrinsics.size_px[1]} px; use one size"
        )
    center = center_px or ((size[0] - 1) / 2, (size[1] - 1) / 2)
    models = [CameraPose.of_unknown(size, bent) for bent in (False, True)]
    cameras: list[CameraPose] = []
    if intrinsics is not None:
        lens = intrinsics.chosen.fit
        known = CameraPose(lens.lens, lens.parameters, lens.covariance, size)
        cameras = [known]
        if media is not None:
            cameras.append(replace(known, media=media, name="camera pose with refraction"))
    fits = fit_planes(views, [*cameras[::-1], *models])
    chosen, near = choose_plane(fits)
    frame = gel_frame(chosen, center, half_mm=pitch, near=near)
    frame = _with_detector_error(frame, chosen, views, center, pitch)
    scale = frame.mm_per_px_x.value, frame.mm_per_px_y.value
    if tactile_px is None:
        grid = PixelGrid(*size, *scale, float(center[0]), float(center[1]))
    else:
        grid = PixelGrid(*tactile_px, *scale)
    by_model = {fit.model.name: fit for fit in fits}
    poses = [
        _pose(by_model[model.name], center, pitch, model)
        for model in cameras
        if model.name in by_model
    ]
    used = poses[-1] if poses else None
    if len(poses) == 2:
        in_air, refracted = poses
        used = in_air if choose_plane([refracted.fit, in_air.fit])[0] is in_air.fit else refracted
    spread = scale_range(chosen, views, pitch)
    said = _remarks(chosen, fits, frame, spread, pitch, views, center)
    return OnGel(
        chosen,
        frame,
        grid,
        (float(center[0]), float(center[1])),
        tuple(views),
        tuple(fits),
        used,
        tuple(poses),
        spread,
        tuple(said),
    )


def _with_detector_error(
    frame: GelFrame,
    fit: PlaneFit,
    views: Sequence[BoardView],
    center: tuple[float, float],
    pitch: float,
) -> GelFrame:
    """The frame with scales as uncertain as other pictures of the same dents say.

    Shading moves all dents of a picture in a way that no residual shows: the mean of the colours
    and their change as a whole differ by up to 0.6 % in scale on the boards at hand, and each by
    up to 0.3 % with the width of the filter that it is looked at through. The largest difference
    counts as a standard deviation.
    """
    own = np.array([frame.mm_per_px_x.value, frame.mm_per_px_y.value])
    off = np.zeros(2)
    for k in range(max(len(view.others_uv_px) for view in views)):
        others = [
            replace(view, uv_px=view.others_uv_px[k]) if k < len(view.others_uv_px) else view
            for view in views
        ]
        seen = gel_frame(fit_plane(others, fit.model), center, half_mm=pitch)
        off = np.maximum(off, np.abs(own - [seen.mm_per_px_x.value, seen.mm_per_px_y.value]))
    x, y = (
        Estimate(scale.value, float(np.hypot(scale.sigma, by)), scale.unit)
        for scale, by in zip((frame.mm_per_px_x, frame.mm_per_px_y), off, strict=True)
    )
    return replace(frame, mm_per_px_x=x, mm_per_px_y=y)


def _pose(
    fit: PlaneFit,
    center: tuple[float, float],
    pitch: float,
    model: CameraPose,
) -> PoseInGel:
    """Camera in the gel frame that this fit itself gives."""
    frame = gel_frame(fit, center, half_mm=pitch)

    def position(theta: np.ndarray) -> np.ndarray:
        rotation = cv2.Rodrigues(theta[:3])[0]
        in_board = -rotation.T @ theta[3:6] - [*frame.origin_mm, 0.0]
        flat = plane_rotation(frame.angle_rad).T @ in_board[:2]
        return np.array([*flat, in_board[2]])

    by_theta = slopes(position, fit.theta[:6])
    sigma = np.sqrt(np.diag(by_theta @ fit.covariance[:6, :6] @ by_theta.T))
    camera_from_board = Rotation.from_rotvec(fit.theta[:3])
    board_from_gel = Rotation.from_rotvec([0.0, 0.0, frame.angle_rad])
    gel_from_camera = (camera_from_board * board_from_gel).inv()
    axis = gel_from_camera.apply([0.0, 0.0, 1.0])
    x, y, z, w = (float(v) for v in gel_from_camera.as_quat())
    px, py, pz = (float(v) for v in position(fit.theta))
    sx, sy, sz = (float(v) for v in sigma)
    return PoseInGel(
        fit,
        (px, py, pz),
        (sx, sy, sz),
        (x, y, z, w),
        float(np.degrees(np.arccos(np.clip(axis[2], -1, 1)))),
        model.media is not None,
    )


def _remarks(
    chosen: PlaneFit,
    fits: Sequence[PlaneFit],
    frame: GelFrame,
    spread: tuple[float, float],
    pitch: float,
    views: Sequence[BoardView],
    center: tuple[float, float],
) -> list[Remark]:
    said = []
    size = views[0].size_px
    if spread[1] - spread[0] > DISTORTED or abs(frame.shear) > MAX_SHEAR:
        said.append(remarks.DISTORTED(least=spread[0], largest=spread[1]))
    pixel_pitch = pitch / frame.mm_per_px_x.value
    if chosen.heldout_px > LARGE_ERROR_PITCHES * pixel_pitch:
        share = chosen.heldout_px / pixel_pitch
        error = f"{chosen.heldout_px:.2f} px, {share:.1%} of its pitch"
        advice = "the board is bent, or its dots are blurred"
        said.append(HELDOUT_ERROR(what="points of the board", error=error, advice=advice))
    points = np.concatenate([view.uv_px for view in views])
    if not (points.min(axis=0) <= center).all() or not (points.max(axis=0) >= center).all():
        said.append(remarks.OFF_CENTER(u=center[0], v=center[1], width=size[0], height=size[1]))
    return said
