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
from taccel_lab.calibration.camera.intrinsics import Intrinsics
from taccel_lab.calibration.camera.plane import (
    CameraPose,
    PlaneFit,
    choose_plane,
    fit_plane,
    fit_planes,
    plane_rotation,
)
from taccel_lab.calibration.remarks import HELDOUT_ERROR
from taccel_lab.calibration.result import Estimate
from taccel_lab.camera.refraction import FlatMedia
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.report.remark import Remark
from taccel_lab.robust_fit import slopes

MIN_POINTS = 8
DISTORTED = 0.02
"""Change of scale under the board from which on the image counts as distorted."""
MAX_SHEAR = 0.01
LARGE_ERROR_PITCHES = 0.05


@dataclass(frozen=True)
class GelFrame:
    """Where the gel frame lies on the plane, and the scale of the image there."""

    origin_mm: np.ndarray
    """The gel frame's origin in the first board's coordinates, shape [2]."""
    angle_rad: float
    """Turn of the gel's x axis against the board's."""
    mm_per_px_x: Estimate
    mm_per_px_y: Estimate
    correlation: float
    shear: float
    """How far the image's axes are from a right angle [rad]."""

    def board_from_gel(self, xy_mm: np.ndarray) -> np.ndarray:
        """Board coordinates of gel points, [n, 2] -> [n, 2]."""
        return np.asarray(xy_mm) @ plane_rotation(self.angle_rad).T + self.origin_mm


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
    """Pixels of the rectified image; they hold for a raw image of that size as far as it is not
    distorted."""
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
    frame = _gel_frame(chosen, center, pitch, near, _shaded_fits(views, chosen.model))
    scale = frame.mm_per_px_x.value, frame.mm_per_px_y.value
    if tactile_px is None:
        grid = PixelGrid(*size, *scale, float(center[0]), float(center[1]))
    else:
        grid = PixelGrid(*tactile_px, *scale)
    poses, used = [_pose(fit, center, pitch) for fit in fits[::-1] if fit.model in cameras], None
    if poses:
        best, _ = choose_plane([pose.fit for pose in poses[::-1]])
        used = next(pose for pose in poses if pose.fit is best)
    spread = _scale_range(chosen, views, pitch)
    said = _remarks(chosen, frame, spread, pitch, views, center)
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


def _shaded_fits(views: Sequence[BoardView], model: CameraPose) -> list[PlaneFit]:
    """Fits to where other pictures of the same dents, and other filters, show them."""

    def other(view: BoardView, k: int) -> BoardView:
        return replace(view, uv_px=view.others_uv_px[k]) if k < len(view.others_uv_px) else view

    count = max(len(view.others_uv_px) for view in views)
    return [fit_plane([other(view, k) for view in views], model) for k in range(count)]


def _pose(fit: PlaneFit, center: tuple[float, float], pitch: float) -> PoseInGel:
    """Camera in the gel frame that this fit itself gives."""
    origin, angle, _, _ = _scale_at(fit, np.array(center), fit.theta, pitch)

    def position(theta: np.ndarray) -> np.ndarray:
        rotation = cv2.Rodrigues(theta[:3])[0]
        in_board = -rotation.T @ theta[3:6] - [*origin, 0.0]
        flat = plane_rotation(angle).T @ in_board[:2]
        return np.array([*flat, in_board[2]])

    by_theta = slopes(position, fit.theta[:6])
    sigma = np.sqrt(np.diag(by_theta @ fit.covariance[:6, :6] @ by_theta.T))
    camera_from_board = Rotation.from_rotvec(fit.theta[:3])
    board_from_gel = Rotation.from_rotvec([0.0, 0.0, angle])
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
        fit.model.media is not None,
    )


def _remarks(
    chosen: PlaneFit,
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


def _gel_frame(
    fit: PlaneFit,
    center_px: tuple[float, float],
    half_mm: float,
    near: Sequence[PlaneFit],
    shaded: Sequence[PlaneFit],
) -> GelFrame:
    """Gel frame with its origin at a pixel: x to the right of the image, y down.

    Args:
        half_mm: The scale is the mean over this distance to both sides of the origin; a pitch of
            the board. In a distorted image, the scale changes over it.
        near: Other fits that explain the points as well; how their scales differ is added to the
            standard deviations.
        shaded: Fits to other pictures of the same dents: shading moves all dents of a picture in a
            way that no residual shows. The mean of the colours and their change as a whole differ
            by up to 0.6 % in scale on the boards at hand, and each by up to 0.3 % with the width of
            the filter that it is looked at through. The largest difference counts as a standard
            deviation.
    """
    center = np.array(center_px, dtype=np.float64)
    origin, angle, scale, shear = _scale_at(fit, center, fit.theta, half_mm)
    covariance = _model_covariance(fit, center, half_mm)
    own = np.diag(covariance).copy()
    systematic = np.zeros(2)
    for other in near:
        if other.model == fit.model:
            continue
        off = _scale_at(other, center, other.theta, half_mm)[2] - scale
        # A richer model is noisier: only what exceeds that is a difference of models (J. Hausman,
        # Econometrica 46, 1978: the variance of the difference is that of the variances).
        noise = np.diag(_model_covariance(other, center, half_mm)) - own
        systematic += np.maximum(off**2 - np.maximum(noise, 0.0), 0.0)
    covariance += np.diag(systematic / max(len(near), 1))
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    product = float(deviation[0] * deviation[1])
    off = [np.abs(scale - _scale_at(other, center, other.theta, half_mm)[2]) for other in shaded]
    sigma = np.hypot(deviation, np.max(off, axis=0) if off else 0.0)
    return GelFrame(
        origin,
        angle,
        Estimate(float(scale[0]), float(sigma[0]), "mm/px"),
        Estimate(float(scale[1]), float(sigma[1]), "mm/px"),
        float(np.clip(covariance[0, 1] / product, -1, 1)) if product > 0 else 0.0,
        shear,
    )


def _model_covariance(fit: PlaneFit, center: np.ndarray, half_mm: float) -> np.ndarray:
    """Covariance of mm/px along x and y by that of the model's parameters, shape [2, 2]."""
    by_theta = slopes(lambda theta: _scale_at(fit, center, theta, half_mm)[2], fit.theta)
    return by_theta @ fit.covariance @ by_theta.T


def _scale_at(
    fit: PlaneFit, center: np.ndarray, theta: np.ndarray, half_mm: float
) -> tuple[np.ndarray, float, np.ndarray, float]:
    """Origin [2], angle, mm/px [2] and shear for given parameters.

    The rotation is the one that makes the derivative of the image by gel coordinates symmetric
    (polar decomposition): no turn is left between the axes of gel and image.
    """
    origin = fit.locate(center, theta)
    u, s, vt = np.linalg.svd(fit.jacobian(origin, theta, half_mm))
    stretch = u @ np.diag(s) @ u.T
    turn = (u @ vt).T
    angle = float(np.arctan2(turn[1, 0], turn[0, 0]))
    return origin, angle, 1.0 / np.diag(stretch), float(2 * stretch[0, 1] / np.trace(stretch))


def _scale_range(fit: PlaneFit, views: Sequence[BoardView], half_mm: float) -> tuple[float, float]:
    """Least and largest local scale under the board, relative to the one at its middle."""
    board = fit.plane_points(views)
    local = np.array([_mean_scale(fit, xy, half_mm) for xy in board])
    at_middle = _mean_scale(fit, board.mean(axis=0), half_mm)
    return float(local.min() / at_middle), float(local.max() / at_middle)


def _mean_scale(fit: PlaneFit, xy_mm: np.ndarray, half_mm: float) -> float:
    return float(1 / np.sqrt(abs(np.linalg.det(fit.jacobian(xy_mm, half_mm=half_mm)))))
