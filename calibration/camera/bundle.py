# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment: one lens and the pose of each board, by robust least squares of all points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.lens import Lens
from taccel_lab.calibration.camera.planar_pose import planar_pose
from taccel_lab.calibration.robust_fit import RobustFit, fit_robustly, rms
from taccel_lab.errors import InputError, naming


@dataclass(frozen=True)
class BundleFit:
    """A fitted lens with the poses of its views."""

    lens: Lens
    fit: RobustFit
    """Of the lens's parameters, then of the views' poses."""
    view: np.ndarray
    """Which view each point is of, int, shape [point]."""

    @property
    def parameters(self) -> np.ndarray:
        """As ``lens.parameter_names``, shape [p]."""
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
        """Of the parameters, shape [p, p]; widened where views disagree more than their points."""
        count = self.lens.parameter_count
        return self.fit.covariance((self.view,))[:count, :count]

    @property
    def converged(self) -> bool:
        return self.fit.converged

    @property
    def rms_px(self) -> float:
        """Root mean square distance of all points."""
        return rms(self.fit.residuals)

    @property
    def view_rms_px(self) -> np.ndarray:
        """The same for each view, shape [view]."""
        return np.array([rms(r) for r in self.residuals])

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
