# SPDX-License-Identifier: Apache-2.0
"""How well a lens predicts views that had no part in its fit.

The views are dealt into k parts by their place in the manifest, before any image is read. Without
one part, everything is done anew from the rest alone: views that do not fit are left out, a start
is looked for, the lens is fitted. Of a held-out view only the pose of the board is fitted, and
all of its points count, however far off they are: an outlier among the views that are fitted is
none among those that are predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.bundle import BundleFit, initial_pose
from taccel_lab.calibration.camera.lens import Lens
from taccel_lab.calibration.camera.lens_fits import LensFits, fit_lenses
from taccel_lab.calibration.camera.planar_pose import fit_pose
from taccel_lab.calibration.robust_fit import rms, robust_scale
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent

_ALIKE = 0.02
"""Share of the best mean square error by which a simpler lens may be worse: 1 % of the error."""
_MIN_TRAIN = 2
"""Views that a lens can be fitted to at all."""


@dataclass(frozen=True)
class LensScore:
    """How well one lens predicts views that it was not fitted to."""

    lens: Lens
    fit: BundleFit
    """To all views that are no outliers."""
    heldout_px: float
    """Root mean square error of all points of all views, outliers too."""
    heldout_robust_px: float
    """The root mean square that normal errors with the same median would have: what it would be
    without outliers."""
    fold_parameters: np.ndarray
    """Of the fits without each part, shape [fold, p]."""
    view_mse: np.ndarray
    """Mean square held-out error of each view, shape [view]: of those that are fitted in the
    end."""
    excess: float
    """Mean difference of ``view_mse`` from the best lens."""
    excess_error: float
    """Its standard error."""

    def errors_px(self) -> dict[str, float]:
        """Root mean square errors: of the fit, and of views that it did not see."""
        return {
            "fit_rms_px": self.fit.rms_px,
            "heldout_rms_px": self.heldout_px,
            "heldout_robust_rms_px": self.heldout_robust_px,
        }

    @property
    def within_one_error(self) -> bool:
        """As good as the best lens, as far as these views can tell or anybody would notice."""
        return self.excess <= max(
            self.excess_error, _ALIKE * (float(self.view_mse.mean()) - self.excess)
        )


def fold_of_views(views: Sequence[BoardView], folds: int) -> np.ndarray:
    """Part that each view is held out with, int, shape [view].

    Its place in the manifest modulo ``folds``; each view is a separate part where a part would
    leave fewer than two views to fit.
    """
    places = np.array([i if view.place is None else view.place for i, view in enumerate(views)])
    parts = places % folds
    if len(views) - np.bincount(parts).max() < _MIN_TRAIN:
        return np.arange(len(views))
    return parts


def score_lenses(
    views: Sequence[BoardView],
    fitted: LensFits,
    folds: int,
    progress: Progress = silent,
) -> list[LensScore]:
    """Cross-validate lenses.

    Args:
        views: All views, outliers too.
        fitted: The lenses fitted to them; these fits have no part in the scores.
        folds: Parts of the views.
        progress: Told how many parts are done, and of how many, counting the fit to all.
    """
    parts = fold_of_views(views, folds)
    names = np.unique(parts)
    lenses = [fit.lens for fit in fitted.fits]
    left = [[np.zeros((0, 2))] * len(views) for _ in lenses]
    parameters: list[list[np.ndarray]] = [[] for _ in lenses]
    for done, name in enumerate(names):
        progress("fitting the lens", done + 1, len(names) + 1)
        train = fit_lenses(
            [v for v, part in zip(views, parts, strict=True) if part != name], lenses
        )
        for k, fit in enumerate(train.fits):
            parameters[k].append(fit.parameters)
            for i in np.flatnonzero(parts == name).tolist():
                left[k][i] = _heldout(views[i], fit.lens, fit.parameters)
    progress("fitting the lens", len(names) + 1, len(names) + 1)
    used = np.array([any(view is kept for kept in fitted.views) for view in views])
    mse = np.array([[rms(r) ** 2 for r in of_lens] for of_lens in left])[:, used]
    # How much worse than the best lens each is, view by view.
    excess = mse - mse[mse.mean(axis=1).argmin()]
    errors = excess.std(axis=1, ddof=1) / np.sqrt(excess.shape[1])
    return [
        LensScore(
            fit.lens,
            fit,
            rms(np.concatenate(left[k])),
            float(np.sqrt(2)) * robust_scale(np.concatenate(left[k])),
            np.stack(parameters[k]),
            mse[k],
            float(excess[k].mean()),
            # Differences below a millionth of a square pixel are rounding.
            max(float(errors[k]), 1e-6),
        )
        for k, fit in enumerate(fitted.fits)
    ]


def _heldout(view: BoardView, lens: Lens, parameters: np.ndarray) -> np.ndarray:
    """Residuals of a held-out view [px], shape [n, 2]."""
    try:
        start = initial_pose(view, lens, parameters)
    except InputError:
        # No pose explains such points: they are as far off as they lie from their own middle.
        return view.uv_px - view.uv_px.mean(axis=0)
    board = view.board_mm()
    pose = fit_pose(lens, parameters, board, view.uv_px, start, robust=False)
    return view.uv_px - lens.project(board, parameters, pose)
