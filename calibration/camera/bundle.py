# SPDX-License-Identifier: Apache-2.0
"""Lenses fitted to views of boards, each with the poses of the boards, by robust least squares of
all points.

OpenCV's calibration gives the start and no more: with a few wrong corners (4 of 576, 30 px off) its
focal lengths are 4.8 px off on average, those of the robust bundle adjustment 0.4 px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from scipy.sparse import csr_array

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.lens import Lens, planar_pose
from taccel_lab.calibration.robust_fit import RobustFit, fit_robustly, rms
from taccel_lab.errors import InputError, naming

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
        return self.fit.covariance((self.view,))[:count, :count]

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
