# SPDX-License-Identifier: Apache-2.0
"""Lens models, from simple to rich, the pose of a plane that one explains, and fits to boards.

A fit to views of boards is robust least squares of all points, each view with the pose of its
board. OpenCV's calibration gives the start and no more: with a few wrong corners (4 of 576, 30 px
off) its focal lengths are 4.8 px off on average, those of the robust bundle adjustment 0.4 px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from scipy.sparse import csr_array

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.options import LensName
from taccel_lab.camera.gel_camera import CameraModel
from taccel_lab.errors import InputError, naming
from taccel_lab.profile.optical_design import DesignedCamera
from taccel_lab.robust_fit import RobustFit, fit_robustly, rms

_GRAZING = 0.05
"""Smallest cosine of a ray to the optical axis: beyond, x / z is no use."""


@dataclass(frozen=True)
class Lens:
    """One family of lenses; its parameters are fx, fy, cx, cy and the free coefficients."""

    name: LensName
    coefficients: int
    """Free distortion coefficients, the first of OpenCV's order."""
    stored: int
    """Coefficients stored in a profile, the rest of them 0."""

    @property
    def parameter_count(self) -> int:
        """Focal lengths, principal point and free coefficients."""
        return 4 + self.coefficients

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        names = ("k1", "k2", "k3", "k4")
        if self.name in ("pinhole", "rational"):
            names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        return ("fx_px", "fy_px", "cx_px", "cy_px", *names[: self.coefficients])

    @property
    def camera_kind(self) -> Literal["pinhole", "fisheye"]:
        """Name of the model in a profile."""
        return "fisheye" if self.name == "fisheye" else "pinhole"

    def project(self, points: np.ndarray, parameters: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Pixels [n, 2] of points [n, 3] under ``pose`` (rotation vector, translation)."""
        return self.project_with_jacobian(points, parameters, pose)[0]

    def project_with_jacobian(
        self, points: np.ndarray, parameters: np.ndarray, pose: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels [n, 2] with derivatives by parameters [n, 2, p] and by the pose [n, 2, 6]."""
        fx, fy, cx, cy = parameters[:4]
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        objects = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 1, 3)
        fisheye, count = self.name == "fisheye", self.coefficients
        bends = np.zeros(4 if fisheye else 8)
        bends[:count] = parameters[4:]
        project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
        uv, jacobian = project(objects, pose[:3].copy(), pose[3:].copy(), matrix, bends)[:2]
        jacobian = np.asarray(jacobian).reshape(len(objects), 2, -1)
        # OpenCV's columns: of a fisheye f, c, k, pose; of others pose, f, c, k.
        by_pose, first = (jacobian[..., 8:14], 0) if fisheye else (jacobian[..., :6], 6)
        return np.asarray(uv).reshape(-1, 2), jacobian[..., first : first + 4 + count], by_pose

    def camera(
        self,
        parameters: np.ndarray,
        size_px: tuple[int, int],
        position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
        rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    ) -> DesignedCamera:
        """The camera as the profile and the renderer describe it."""
        fx, fy, cx, cy, *bends = (float(v) for v in parameters)
        bends += [0.0] * (self.stored - len(bends))
        return DesignedCamera(
            *size_px, fx, fy, cx, cy, position_mm, rotation, self.camera_kind, tuple(bends)
        )

    def directions(
        self, parameters: np.ndarray, size_px: tuple[int, int], uv_px: np.ndarray
    ) -> np.ndarray:
        """Unit sight lines [n, 3] of pixels [n, 2] in the camera's frame; NaN beyond the lens."""
        camera = self.camera(parameters, size_px)
        return CameraModel(camera).directions_from_pixels(uv_px)


LENSES: dict[str, Lens] = {
    "k1": Lens("k1", 1, 4),
    "fisheye": Lens("fisheye", 4, 4),
    "pinhole": Lens("pinhole", 5, 5),
    "rational": Lens("rational", 8, 8),
}
"""Lenses by name, the simplest first: the order of preference among models that predict alike."""


def planar_pose(
    lens: Lens,
    parameters: np.ndarray,
    size_px: tuple[int, int],
    xy_mm: np.ndarray,
    uv_px: np.ndarray,
) -> np.ndarray:
    """The pose, among those that a plane's points allow, each refined, that misses least:
    camera_from_plane as rotation vector and translation [mm], shape [6].

    Args:
        lens: Lens model and its ``parameters`` [p] for images of ``size_px``.
        xy_mm: Points on the plane z = 0, shape [n, 2].
        uv_px: Where they are seen, shape [n, 2].

    Raises:
        InputError: Fewer than 4 of the points lie within the lens's field, or no pose.
    """
    points = np.column_stack([xy_mm, np.zeros(len(xy_mm))])
    starts = _starts(lens.directions(parameters, size_px, uv_px), points)
    poses = [fit_pose(lens, parameters, points, uv_px, start) for start in starts]
    if not poses:
        raise InputError(f"no pose of the plane explains its {len(points)} points")
    return min(poses, key=lambda pose: rms(uv_px - lens.project(points, parameters, pose)))


def fit_pose(
    lens: Lens,
    parameters: np.ndarray,
    points_mm: np.ndarray,
    uv_px: np.ndarray,
    pose: np.ndarray,
    robust: bool = True,
) -> np.ndarray:
    """Pose of points [n, 3] with the lens held fixed, by least squares from ``pose`` [6]."""
    return fit_robustly(
        lambda x: uv_px - lens.project(points_mm, parameters, x),
        pose,
        jacobian=lambda x: -lens.project_with_jacobian(points_mm, parameters, x)[2].reshape(-1, 6),
        robust=robust,
    ).x


def _starts(rays: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """Poses to start from, each [6], of points [n, 3] that are seen along rays [n, 3].

    IPPE (Collins & Bartoli 2014) gives both poses between which a plane seen from afar is
    ambiguous; on a plane that is exactly parallel to the image it may divide by zero, so SQPnP
    (Terzakis & Lourakis 2020), which gives one pose, is asked as well.
    """
    seen = np.isfinite(rays).all(axis=1) & (rays[:, 2] > _GRAZING)
    if seen.sum() < 4:
        raise InputError("fewer than 4 points lie within the lens's field")
    plane = (rays[seen, :2] / rays[seen, 2:]).reshape(-1, 1, 2)
    poses = []
    for method in (cv2.SOLVEPNP_IPPE, cv2.SOLVEPNP_SQPNP):
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            points[seen].reshape(-1, 1, 3), plane, np.eye(3), None, flags=method
        )
        poses += [
            np.concatenate([np.ravel(rotations[i]), np.ravel(translations[i])])
            for i in range(count)
        ]
    return [pose for pose in poses if np.isfinite(pose).all()]


MIN_VIEWS = 3
OUTLIER_RATIO = 3.0
"""A view whose error is this many times the median of all views is left out."""
_FOCAL_SHARES = (0.3, 5.0)
"""Focal lengths, in image widths, between which OpenCV's is believed."""


@dataclass(frozen=True)
class BundleFit:
    """A fitted lens with the poses of its views."""

    lens: Lens
    fit: RobustFit
    """Fit of the lens's parameters, then of the views' poses."""
    view: np.ndarray
    """Which view each point is of, int, shape [point]."""
    focal_spread: float = 0.0
    """Standard deviation of the views' own focal lengths, as a part of the common one."""

    @property
    def parameters(self) -> np.ndarray:
        """The lens's, as ``lens.parameter_names``, shape [p]."""
        return self.fit.x[: self.lens.parameter_count]

    @property
    def poses(self) -> np.ndarray:
        """camera_from_board as rotation vector and translation, shape [view, 6]."""
        return self.fit.x[self.lens.parameter_count :].reshape(-1, 6)

    @property
    def residuals(self) -> tuple[np.ndarray, ...]:
        """Seen minus projected [px], per view, each [n, 2]."""
        return tuple(np.split(self.fit.residuals, np.flatnonzero(np.diff(self.view)) + 1))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the parameters, [p, p]; wider where views disagree more than points."""
        count = self.lens.parameter_count
        covariance = self.fit.covariance((self.view,))[:count, :count]
        focal = self.focal_spread * self.parameters[:2]
        covariance[:2, :2] += np.outer(focal, focal)
        return covariance

    @property
    def rms_px(self) -> float:
        """Root mean square distance of all points."""
        return rms(self.fit.residuals)

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation of each parameter, shape [p]."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def fit_bundle(
    views: Sequence[BoardView], lens: Lens, start: np.ndarray, poses: np.ndarray | None = None
) -> BundleFit:
    """Fit a lens to views from the ``start`` parameters [p] and ``poses`` [view, 6], looked for
    without.

    Raises:
        InputError: Too few points for the unknowns.
    """
    count = lens.parameter_count
    unknowns = count + 6 * len(views)
    sizes = [len(view.index) for view in views]
    if 2 * sum(sizes) <= unknowns or len(views) < 2:
        raise InputError(
            f"{len(views)} views with {sum(sizes)} points cannot fit a {lens.name} lens; more "
            "views of the board are needed"
        )
    if poses is None:
        poses = np.stack([initial_pose(view, lens, start) for view in views])
    boards = [view.board_mm() for view in views]
    seen = np.concatenate([view.uv_px for view in views])
    of_view = np.repeat(np.arange(len(views)), sizes)
    # Each point depends on the lens and on the pose of its own view.
    own = np.column_stack(
        [np.tile(np.arange(count), (len(seen), 1)), count + 6 * of_view[:, None] + np.arange(6)]
    )
    columns, ends = np.repeat(own, 2, axis=0).ravel(), np.arange(2 * len(seen) + 1) * own.shape[1]

    def projected(x: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        return [
            lens.project_with_jacobian(board, x[:count], pose)
            for board, pose in zip(boards, x[count:].reshape(-1, 6), strict=True)
        ]

    def residuals(x: np.ndarray) -> np.ndarray:
        if not _plausible(x, views[0].size_px):
            return np.full(seen.shape, np.nan)
        return seen - np.concatenate([uv for uv, _, _ in projected(x)])

    def jacobian(x: np.ndarray) -> csr_array:
        parts = [np.concatenate([by_lens, by_pose], 2) for _, by_lens, by_pose in projected(x)]
        return csr_array((-np.concatenate(parts).ravel(), columns, ends))

    first = np.concatenate([start, np.ravel(poses)])
    return BundleFit(lens, fit_robustly(residuals, first, jacobian=jacobian), of_view)


def initial_pose(view: BoardView, lens: Lens, parameters: np.ndarray) -> np.ndarray:
    """camera_from_board of a view; InputError where no pose explains its points."""
    with naming(view.source):
        return planar_pose(lens, parameters, view.size_px, view.board_mm()[:, :2], view.uv_px)


def _plausible(x: np.ndarray, size_px: tuple[int, int]) -> bool:
    """Guards the search: focal lengths of 0.05 to 50 image widths, a middle near the image."""
    longest = max(size_px)
    focal, middle = x[:2], x[2:4]
    near = ((middle > -longest) & (middle < 2 * longest)).all()
    return bool(near and ((focal > 0.05 * longest) & (focal < 50 * longest)).all())


def excess_over_best(scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much worse each of several models scores than the best, on average, and its standard
    error, both [model]; ``scores`` are held-out square errors, shape [model, item]."""
    excess = scores - scores[scores.mean(axis=1).argmin()]
    return excess.mean(axis=1), excess.std(axis=1, ddof=1) / np.sqrt(excess.shape[1])


def fit_lenses(
    views: Sequence[BoardView], lenses: Sequence[Lens]
) -> tuple[list[BundleFit], list[BoardView], list[str]]:
    """Fit every lens to the views that one of them explains, at least two thirds of them.

    That lens starts from OpenCV's focal lengths, the others from what it found.

    Returns:
        Fits of the lenses in their order, the views that were fitted, and what is wrong with the
        others.

    Raises:
        InputError: Too few points for the unknowns, or no pose that explains a view.
    """
    kept, outliers = list(views), []
    lens = next((lens for lens in lenses if lens.name in ("pinhole", "fisheye")), lenses[-1])
    first = _first_fit(kept, lens)
    while len(outliers) < len(views) // 3 and len(kept) > MIN_VIEWS:
        errors = [rms(residuals) for residuals in first.residuals]
        limit = max(OUTLIER_RATIO * float(np.median(errors)), 1e-6)
        worst = int(np.argmax(errors))
        if errors[worst] <= limit:
            break
        outliers.append(
            f"{kept[worst].source}: {errors[worst]:.2f} px off, the median view "
            f"{np.median(errors):.2f} px; the board moved, is bent, or its points are mistaken"
        )
        del kept[worst]
        first = fit_bundle(kept, lens, first.parameters, np.delete(first.poses, worst, axis=0))
    fits = [
        first if other is lens else fit_bundle(kept, other, _as_start(first, other), first.poses)
        for other in lenses
    ]
    return fits, kept, outliers


def _first_fit(views: list[BoardView], lens: Lens) -> BundleFit:
    """Fit from OpenCV's focal lengths, or, where no pose explains a view by them, from one image
    width."""
    width, height = views[0].size_px
    start = np.zeros(lens.parameter_count)
    start[:4] = width, width, (width - 1) / 2, (height - 1) / 2
    found = start.copy()
    found[:2] = _opencv_focal(views)
    try:
        return fit_bundle(views, lens, found)
    except InputError:
        return fit_bundle(views, lens, start)


def _opencv_focal(views: list[BoardView]) -> np.ndarray:
    """Focal lengths fx, fy by OpenCV with one radial term; an image width where it finds none."""
    width = views[0].size_px[0]
    try:
        matrix = cv2.calibrateCameraExtended(
            [view.board_mm().astype(np.float32) for view in views],
            [view.uv_px.astype(np.float32) for view in views],
            views[0].size_px,
            np.eye(3),
            np.zeros(5),
            flags=cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
        )[1]
    except cv2.error:
        return np.full(2, float(width))
    # In whole pixels: OpenCV adds up in threads, and its last digits differ from run to run.
    focal = np.rint(np.diag(matrix)[:2])
    low, high = (share * width for share in _FOCAL_SHARES)
    return focal if ((focal > low) & (focal < high)).all() else np.full(2, float(width))


def _as_start(fit: BundleFit, lens: Lens) -> np.ndarray:
    """Parameters of another lens as far as they mean the same."""
    start = np.zeros(lens.parameter_count)
    both = 4
    if fit.lens.camera_kind == lens.camera_kind:
        both = min(fit.lens.parameter_count, lens.parameter_count)
    start[:both] = fit.parameters[:both]
    return start
