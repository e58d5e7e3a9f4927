# SPDX-License-Identifier: Apache-2.0
"""Intrinsics and distortion of a camera from views of a board; the lens is chosen by prediction.

Every lens is fitted to all views, and k times without one part of them, which scores it. The
simplest lens whose held-out error is within one standard error of the best one's, over the views
that are no outliers, is chosen.

The views are dealt into k parts by their place in the manifest, before any image is read. Without
one part, everything is done anew from the rest alone: views that do not fit are left out, a start
is looked for, the lens is fitted. Of a held-out view only the pose of the board is fitted, and
all of its points count, however far off they are: an outlier among the views that are fitted is
none among those that are predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import ConvexHull

from taccel_lab.calibration.camera import remarks
from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.lens import (
    LENSES,
    MIN_VIEWS,
    BundleFit,
    Lens,
    excess_over_best,
    fit_lenses,
    fit_pose,
    initial_pose,
)
from taccel_lab.calibration.camera.view_focals import ViewFocals, differing_focals
from taccel_lab.calibration.remarks import HELDOUT_ERROR, TOO_FEW
from taccel_lab.errors import InputError
from taccel_lab.printable import counted
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark
from taccel_lab.robust_fit import rms, robust_scale

MIN_COVERAGE = 0.35
MIN_TILT_DEG = 10.0
MAX_FOCAL_SIGMA = 0.02
LOST_FOCAL_SIGMA = 0.1
"""Standard deviation of the focal length, relative, above which it is as good as unknown."""
MAX_RMS_SHARE = 2e-3
"""Error of reprojection that is still usual, in image widths: 1.3 px of 640."""
WRONG_RMS = 3.0
"""Errors this many times as large are no lens: the points are not those of the board."""
_ALIKE = 0.02
"""Share of the best mean square error by which a simpler lens may be worse: 1 % of the error."""
_MIN_TRAIN = 2
"""Views that a lens can be fitted to at all."""


@dataclass(frozen=True)
class LensScore:
    """How well one lens predicts views that it was not fitted to."""

    lens: Lens
    fit: BundleFit
    """Fit to all views that are no outliers."""
    heldout_px: float
    """Root mean square error of all points of all views, outliers too."""
    heldout_robust_px: float
    """The root mean square that normal errors with the same median would have: what it would be
    without outliers."""
    fold_parameters: np.ndarray
    """Parameters of the fits without each part, shape [fold, p]."""
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
        """Whether it is as good as the best lens, as far as views tell or anybody would notice."""
        return self.excess <= max(
            self.excess_error, _ALIKE * (float(self.view_mse.mean()) - self.excess)
        )


@dataclass(frozen=True)
class Intrinsics:
    """A camera's lens with what it was chosen from."""

    chosen: LensScore
    scores: tuple[LensScore, ...]
    """All lenses, the simplest first."""
    views: tuple[BoardView, ...]
    """Views that were fitted."""
    outliers: tuple[str, ...]
    """Views that were left out, with the reason."""
    folds: int
    coverage: float
    """Share of the image that the points of all views enclose."""
    tilt_deg: tuple[float, float]
    """Smallest and largest tilt of the board against the image plane."""
    remarks: tuple[Remark, ...]

    @property
    def lens(self) -> Lens:
        return self.chosen.lens

    @property
    def parameters(self) -> np.ndarray:
        """The lens's, as ``lens.parameter_names``."""
        return self.chosen.fit.parameters

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images."""
        return self.views[0].size_px


def require_choices(models: Sequence[str], folds: int) -> list[Lens]:
    """The lenses of these names, the simplest first; InputError for an unknown one, or fewer than
    two folds."""
    if folds < 2:
        raise InputError(f"folds must be at least 2, got {folds}")
    unknown = [name for name in models if name not in LENSES]
    if unknown or not models:
        raise InputError(
            f"unknown lens model {', '.join(map(repr, unknown)) or 'none'}; allowed: "
            f"{', '.join(LENSES)}"
        )
    return [lens for name, lens in LENSES.items() if name in models]


def calibrate_intrinsics(
    views: Sequence[BoardView],
    *,
    models: Sequence[str] = tuple(LENSES),
    folds: int = 5,
    refused: Sequence[str] = (),
    progress: Progress = silent,
) -> Intrinsics:
    """Fit and choose a lens.

    Args:
        views: Of one board of any kind, from several sides; parts of it are enough.
        models: Names of the lenses to choose from.
        folds: Parts of the views for cross-validation, by ``BoardView.place``.
        refused: Why there are no more views, for the error message.

    Raises:
        InputError: Too few views, or none that a lens explains.
    """
    lenses = require_choices(models, folds)
    if len(views) < MIN_VIEWS:
        sides = "better 20, from different sides and tilted by 20 to 45 degrees"
        if not refused:
            raise InputError(
                f"{len(views)} views of the board are too few for intrinsics; at least "
                f"{MIN_VIEWS}, {sides}"
            )
        raise InputError(
            f"{len(views)} views of the board are left, at least {MIN_VIEWS} are needed, {sides}; "
            "not used:\n" + "\n".join(refused[:5])
        )
    fits, kept, outliers = fit_lenses(views, lenses)
    used = np.array([any(view is one for one in kept) for view in views])
    scores = _score_lenses(views, used, fits, folds, progress)
    chosen = next(score for score in scores if score.within_one_error)
    focals = differing_focals(views, chosen.fit)
    if focals is not None:
        wider = replace(chosen, fit=replace(chosen.fit, focal_spread=focals.spread))
        scores = [wider if score is chosen else score for score in scores]
        chosen = wider
    points = np.concatenate([view.uv_px for view in kept])
    coverage = float(ConvexHull(points).volume / np.prod(kept[0].size_px))
    # Unit normals of the boards in the camera's frame.
    normals = np.array([cv2.Rodrigues(pose[:3])[0][:, 2] for pose in chosen.fit.poses])
    tilts = np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0, 1)))
    apart_deg = np.degrees(np.arccos(np.clip(np.abs(normals @ normals.T), 0, 1)))
    tilt = float(tilts.min()), float(tilts.max())
    return Intrinsics(
        chosen,
        tuple(scores),
        tuple(kept),
        tuple(outliers),
        len(chosen.fold_parameters),
        coverage,
        tilt,
        tuple(_remarks(chosen, kept, coverage, tilt[1], float(apart_deg.max()), focals)),
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


def _score_lenses(
    views: Sequence[BoardView],
    used: np.ndarray,
    fits: Sequence[BundleFit],
    folds: int,
    progress: Progress,
) -> list[LensScore]:
    """Cross-validate lenses.

    Args:
        views: All views, outliers too.
        used: Views that are no outliers, bool, shape [view].
        fits: The lenses fitted to those; these fits have no part in the scores.
        folds: Parts of the views.
        progress: Informed of how many parts are done, and of how many, counting the fit to all.
    """
    parts = fold_of_views(views, folds)
    names = np.unique(parts)
    lenses = [fit.lens for fit in fits]
    left = [[np.zeros((0, 2))] * len(views) for _ in lenses]
    parameters: list[list[np.ndarray]] = [[] for _ in lenses]
    for done, name in enumerate(names):
        progress("fitting the lens", done + 1, len(names) + 1)
        rest = [view for view, part in zip(views, parts, strict=True) if part != name]
        for k, fit in enumerate(fit_lenses(rest, lenses)[0]):
            parameters[k].append(fit.parameters)
            for i in np.flatnonzero(parts == name).tolist():
                left[k][i] = _heldout(views[i], fit.lens, fit.parameters)
    progress("fitting the lens", len(names) + 1, len(names) + 1)
    mse = np.array([[rms(r) ** 2 for r in of_lens] for of_lens in left])[:, used]
    excess, errors = excess_over_best(mse)
    return [
        LensScore(
            fit.lens,
            fit,
            rms(np.concatenate(left[k])),
            float(np.sqrt(2)) * robust_scale(np.concatenate(left[k])),
            np.stack(parameters[k]),
            mse[k],
            float(excess[k]),
            # Differences below a millionth of a square pixel are rounding.
            max(float(errors[k]), 1e-6),
        )
        for k, fit in enumerate(fits)
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


def _remarks(
    chosen: LensScore,
    views: list[BoardView],
    coverage: float,
    tilt_deg: float,
    apart_deg: float,
    focals: ViewFocals | None,
) -> list[Remark]:
    """``tilt_deg``: the largest tilt; ``apart_deg``: the largest angle between two boards;
    ``focals``: those of the views, where they differ."""
    said = []
    width = views[0].size_px[0]
    focal, sigma = chosen.fit.parameters[:2], chosen.fit.sigma[:2]
    if len(views) < 10:
        found = f"{counted(len(views), 'view')} of the board"
        said.append(TOO_FEW(found=found, wanted=remarks.MORE_VIEWS))
    if coverage < MIN_COVERAGE:
        said.append(remarks.LENS_COVERAGE(share=coverage))
    if tilt_deg < MIN_TILT_DEG:
        reason = f"no view is tilted by more than {tilt_deg:.1f} degrees"
        said.append(remarks.VIEWS_ALIKE(reason=reason))
    elif apart_deg < MIN_TILT_DEG:
        reason = f"all views show the board from one side, within {apart_deg:.1f} degrees"
        said.append(remarks.VIEWS_ALIKE(reason=reason))
    if focals is not None:
        said.append(remarks.FOCALS_DIFFER(**focals.figures()))
    elif (sigma > MAX_FOCAL_SIGMA * focal).any():
        said.append(
            remarks.FOCAL_UNCERTAIN(
                percent=100 * float((sigma / focal).max()),
                grave=bool((sigma > LOST_FOCAL_SIGMA * focal).any()),
            )
        )
    usual = MAX_RMS_SHARE * width
    # Views that are outliers are left out, and stand in the report.
    if chosen.heldout_robust_px > usual or not chosen.fit.fit.converged:
        wrong = chosen.heldout_robust_px > WRONG_RMS * usual or not chosen.fit.fit.converged
        said.append(
            HELDOUT_ERROR(
                what="views of the board",
                error=f"{chosen.heldout_robust_px:.2f} px, usual are less than {usual:.1f} px",
                advice="the points are not those of the board: check its kind, columns and rows"
                if wrong
                else "the board is bent, or no model fits the lens",
                grave=wrong,
            )
        )
    return said
