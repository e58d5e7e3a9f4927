# SPDX-License-Identifier: Apache-2.0
"""Intrinsics and distortion of a camera from views of a board; the lens is chosen by prediction.

Every lens is fitted k times, each time without one part of the views. Of a view that is held out,
only the pose of the board is fitted; what is left is its held-out error. Two figures are given:
``all`` fits that pose to all its points and scores all of them, as is usual; ``half`` fits it to
every other point and scores the others, and the other way round, which no pose can flatter. The
simplest lens whose ``half`` error is within one standard error of the best one's is chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from calibration.camera.board import BoardView
from calibration.camera.bundle import BundleFit, fit_bundle, fit_pose, rms
from calibration.camera.lens import LENSES, Lens, chosen_lenses
from calibration.result import Remark, Severity
from taccel_lab.errors import InputError

MIN_VIEWS = 3
OUTLIER_RATIO = 3.0
"""A view whose error is this many times the median of all views is left out."""
_FOCAL_STARTS = (0.35, 0.6, 1.0, 1.8, 3.5)
"""Focal lengths tried, in image widths."""
_ALIKE = 0.02
"""Share of the best mean square error by which a simpler lens may be worse: 1 % of the error."""
_START_VIEWS = 6
_FIRST_STEPS = 25
"""Steps after which the starts are compared."""
MIN_COVERAGE = 0.35
MIN_TILT_DEG = 10.0
MAX_FOCAL_SIGMA = 0.02
LOST_FOCAL_SIGMA = 0.1
"""Standard deviation of the focal length, relative, above which it is as good as unknown."""
MAX_RMS_SHARE = 2e-3
"""Error of reprojection that is still usual, in image widths: 1.3 px of 640."""
WRONG_RMS = 3.0
"""Errors this many times as large are no lens: the points are not those of the board."""
MAX_OUTLIER_SHARE = 0.2


@dataclass(frozen=True)
class LensScore:
    """How well one lens predicts views that it was not fitted to."""

    lens: Lens
    fit: BundleFit
    """To all views."""
    heldout_all_px: float
    heldout_half_px: float
    view_mse: np.ndarray
    """Mean square held-out error of each view, ``half`` protocol, shape [view]."""
    excess: float = 0.0
    """Mean difference of ``view_mse`` from the best lens."""
    excess_error: float = 0.0
    """Its standard error."""

    @property
    def within_one_error(self) -> bool:
        """As good as the best lens, as far as these views can tell or anybody would notice."""
        best = float(np.mean(self.view_mse)) - self.excess
        return self.excess <= max(self.excess_error, _ALIKE * best)


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
        """As ``lens.parameter_names``."""
        return self.chosen.fit.parameters

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images."""
        return self.views[0].size_px


def require_choices(models: Sequence[str], folds: int) -> list[Lens]:
    """The lenses of these names; InputError for an unknown one, or fewer than two folds."""
    if folds < 2:
        raise InputError(f"folds must be at least 2, got {folds}")
    return chosen_lenses(list(models))


def calibrate_intrinsics(
    views: Sequence[BoardView],
    *,
    models: Sequence[str] = tuple(LENSES),
    folds: int = 5,
    progress: Callable[[int, int], None] | None = None,
) -> Intrinsics:
    """Fit and choose a lens.

    Args:
        views: Of one board of any kind, from several sides; parts of it are enough.
        models: Names of the lenses to choose from.
        folds: Parts of the views for cross-validation.

    Raises:
        InputError: Too few views, or none that a lens explains.
    """
    lenses = require_choices(models, folds)
    if len(views) < MIN_VIEWS:
        raise InputError(
            f"{len(views)} views of the board are too few for intrinsics; at least {MIN_VIEWS}, "
            "better 20, from different sides and tilted by 20 to 45 degrees"
        )
    total, done = len(lenses) * (min(folds, len(views)) + 1), 0

    def advance() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    kept, outliers = _without_outliers(list(views), lenses)
    scores, start = [], None
    for lens in lenses:
        fit = best_fit(kept, lens, start)
        advance()
        start = fit
        scores.append(_score(kept, fit, min(folds, len(kept)), advance))
    scores = _compare(scores)
    chosen = next(score for score in scores if score.within_one_error)
    coverage, tilt = _coverage(kept), _tilts(chosen.fit)
    return Intrinsics(
        chosen,
        tuple(scores),
        tuple(kept),
        tuple(outliers),
        min(folds, len(kept)),
        coverage,
        tilt,
        tuple(_remarks(chosen, kept, outliers, coverage, tilt)),
    )


def best_fit(views: list[BoardView], lens: Lens, simpler: BundleFit | None = None) -> BundleFit:
    """Fit from several focal lengths to some views, then the best of them to all.

    ``simpler``: a fit of the same views with another lens, whose solution is a start too.
    """
    width, height = views[0].size_px
    step = max(1, len(views) // _START_VIEWS)
    some = views[::step] if len(views[::step]) >= MIN_VIEWS else views
    starts = []
    for share in _FOCAL_STARTS:
        start = np.zeros(lens.parameter_count)
        start[:4] = share * width, share * width, (width - 1) / 2, (height - 1) / 2
        starts.append(start)
    if simpler is not None:
        start = np.zeros(lens.parameter_count)
        both = 4
        if simpler.lens.camera_kind == lens.camera_kind:
            both = min(simpler.lens.parameter_count, lens.parameter_count)
        start[:both] = simpler.parameters[:both]
        starts.insert(0, start)
    fits, errors = [], []
    for start in starts:
        try:
            fits.append(fit_bundle(some, lens, start, steps=_FIRST_STEPS))
        except InputError as error:
            errors.append(error)
    if not fits:
        raise errors[0]
    fits.sort(key=lambda fit: fit.rms_px)
    for fit in fits:
        try:
            return fit_bundle(views, lens, fit.parameters)
        except InputError as error:
            errors.append(error)
    raise errors[-1]


def _without_outliers(
    views: list[BoardView], lenses: list[Lens]
) -> tuple[list[BoardView], list[str]]:
    """Views that one lens explains, at least two thirds of them, and what is wrong with others."""
    outliers: list[str] = []
    most = len(views) // 3
    lens = next((lens for lens in lenses if lens.name in ("pinhole", "fisheye")), lenses[-1])
    while len(outliers) < most and len(views) > MIN_VIEWS:
        errors = best_fit(views, lens).view_rms_px
        limit = max(OUTLIER_RATIO * float(np.median(errors)), 1e-6)
        worst = int(np.argmax(errors))
        if errors[worst] <= limit:
            break
        outliers.append(
            f"{views[worst].source}: {errors[worst]:.2f} px off, the median view "
            f"{np.median(errors):.2f} px; the board moved, is bent, or its points are mistaken"
        )
        views = [view for i, view in enumerate(views) if i != worst]
    return views, outliers


def _score(
    views: list[BoardView], fit: BundleFit, folds: int, advance: Callable[[], None]
) -> LensScore:
    """Cross-validate one lens: fold f holds out views f, f + folds, ..."""
    lens = fit.lens
    everything, halves = [np.zeros((0, 2))] * len(views), [np.zeros((0, 2))] * len(views)
    for fold in range(folds):
        held = list(range(fold, len(views), folds))
        train = [i for i in range(len(views)) if i not in held]
        parameters = fit.parameters
        if len(train) >= 2:
            parameters = fit_bundle(
                [views[i] for i in train], lens, fit.parameters, fit.poses[train]
            ).parameters
        for i in held:
            everything[i], halves[i] = _heldout(views[i], lens, parameters, fit.poses[i])
        advance()
    return LensScore(
        lens,
        fit,
        rms(np.concatenate(everything)),
        rms(np.concatenate(halves)),
        np.array([rms(r) ** 2 for r in halves]),
    )


def _heldout(
    view: BoardView, lens: Lens, parameters: np.ndarray, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of a held-out view by both protocols, each [n, 2]."""
    board = view.board_mm()
    fitted = fit_pose(view, lens, parameters, pose, robust=False)
    full = view.uv_px - lens.project(board, parameters, fitted)
    even = view.index.sum(axis=1) % 2 == 0
    half = np.empty_like(full)
    for part in (even, ~even):
        if part.sum() < 4 or not _plane(view.index[part]):
            half[~part] = full[~part]
            continue
        pose_of_part = fit_pose(view.take(part), lens, parameters, fitted, robust=False)
        half[~part] = (view.uv_px - lens.project(board, parameters, pose_of_part))[~part]
    return full, half


def _plane(index: np.ndarray) -> bool:
    centred = index - index.mean(axis=0)
    return bool(np.linalg.matrix_rank(centred) == 2)


def _compare(scores: list[LensScore]) -> list[LensScore]:
    """Fill in how much worse than the best lens each is, view by view."""
    best = min(scores, key=lambda score: float(np.mean(score.view_mse)))
    compared = []
    for score in scores:
        difference = score.view_mse - best.view_mse
        error = float(difference.std(ddof=1) / np.sqrt(len(difference)))
        # Differences below a millionth of a square pixel are rounding.
        compared.append(
            LensScore(
                score.lens,
                score.fit,
                score.heldout_all_px,
                score.heldout_half_px,
                score.view_mse,
                float(difference.mean()),
                max(error, 1e-6),
            )
        )
    return compared


def _coverage(views: list[BoardView]) -> float:
    points = np.concatenate([view.uv_px for view in views])
    width, height = views[0].size_px
    return float(ConvexHull(points).volume / (width * height))


def _normals(fit: BundleFit) -> np.ndarray:
    """Unit normals of the boards in the camera's frame, shape [view, 3]."""
    import cv2

    return np.array([cv2.Rodrigues(pose[:3])[0][:, 2] for pose in fit.poses])


def _tilts(fit: BundleFit) -> tuple[float, float]:
    tilts = np.degrees(np.arccos(np.clip(np.abs(_normals(fit)[:, 2]), 0, 1)))
    return float(tilts.min()), float(tilts.max())


def _spread_deg(fit: BundleFit) -> float:
    """Largest angle between the planes of two views [deg]."""
    normals = _normals(fit)
    return float(np.degrees(np.arccos(np.clip(np.abs(normals @ normals.T), 0, 1))).max())


def _remarks(
    chosen: LensScore,
    views: list[BoardView],
    outliers: list[str],
    coverage: float,
    tilt: tuple[float, float],
) -> list[Remark]:
    remarks = []
    width = views[0].size_px[0]
    focal, sigma = chosen.fit.parameters[:2], chosen.fit.sigma[:2]
    spread = _spread_deg(chosen.fit)
    if outliers:
        remarks.append(
            Remark(
                Severity.WARNING
                if len(outliers) > MAX_OUTLIER_SHARE * (len(outliers) + len(views))
                else Severity.INFO,
                "outlier_views",
                f"{len(outliers)} of {len(outliers) + len(views)} views were left out: "
                + "; ".join(outliers[:3]),
            )
        )
    if not chosen.fit.converged:
        remarks.append(
            Remark(Severity.ERROR, "not_converged", "the fit of the lens did not converge")
        )
    if len(views) < 10:
        remarks.append(
            Remark(
                Severity.WARNING,
                "few_views",
                f"only {len(views)} views of the board; 20 or more, spread over the image, "
                "determine the distortion",
            )
        )
    if coverage < MIN_COVERAGE:
        remarks.append(
            Remark(
                Severity.WARNING,
                "coverage",
                f"the board covers {coverage:.0%} of the image; the distortion is unknown beyond. "
                "Show the board in the corners too",
            )
        )
    if tilt[1] < MIN_TILT_DEG:
        remarks.append(
            Remark(
                Severity.ERROR,
                "no_tilt",
                f"no view is tilted by more than {tilt[1]:.1f} degrees, so that the focal length "
                "cannot be told from the distance; tilt the board by 20 to 45 degrees",
            )
        )
    elif spread < MIN_TILT_DEG:
        remarks.append(
            Remark(
                Severity.ERROR,
                "views_alike",
                f"all views show the board from one side, within {spread:.1f} degrees, so that "
                "the focal length cannot be told from the distance; tilt it to all sides",
            )
        )
    if (sigma > MAX_FOCAL_SIGMA * focal).any():
        unknown = (sigma > LOST_FOCAL_SIGMA * focal).any()
        remarks.append(
            Remark(
                Severity.ERROR if unknown else Severity.WARNING,
                "focal_uncertain",
                f"the focal length is known to {100 * float((sigma / focal).max()):.1f} % only; "
                "take more views with more tilt",
            )
        )
    usual = MAX_RMS_SHARE * width
    if chosen.heldout_all_px > usual:
        wrong = chosen.heldout_all_px > WRONG_RMS * usual
        remarks.append(
            Remark(
                Severity.ERROR if wrong else Severity.WARNING,
                "large_error",
                f"held-out views are {chosen.heldout_all_px:.2f} px off, usual are less than "
                f"{usual:.1f} px; "
                + (
                    "the points are not those of the board: check its kind, columns and rows"
                    if wrong
                    else "the board is bent, or no model fits the lens"
                ),
            )
        )
    return remarks
