# SPDX-License-Identifier: Apache-2.0
"""Intrinsics and distortion of a camera from views of a board; the lens is chosen by prediction.

Every lens is fitted to all views, and k times without one part of them, which scores it
(``heldout``). The simplest lens whose held-out error is within one standard error of the best
one's, over the views that are no outliers, is chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from taccel_lab.calibration.camera import remarks
from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.bundle import BundleFit
from taccel_lab.calibration.camera.heldout import LensScore, score_lenses
from taccel_lab.calibration.camera.lens import LENSES, Lens
from taccel_lab.calibration.camera.lens_fits import MIN_VIEWS, fit_lenses
from taccel_lab.calibration.shared_remarks import HELDOUT_ERROR, TOO_FEW
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark

MIN_COVERAGE = 0.35
MIN_TILT_DEG = 10.0
MAX_FOCAL_SIGMA = 0.02
LOST_FOCAL_SIGMA = 0.1
"""Standard deviation of the focal length, relative, above which it is as good as unknown."""
MAX_RMS_SHARE = 2e-3
"""Error of reprojection that is still usual, in image widths: 1.3 px of 640."""
WRONG_RMS = 3.0
"""Errors this many times as large are no lens: the points are not those of the board."""


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
    progress: Progress = silent,
) -> Intrinsics:
    """Fit and choose a lens.

    Args:
        views: Of one board of any kind, from several sides; parts of it are enough.
        models: Names of the lenses to choose from.
        folds: Parts of the views for cross-validation, by ``BoardView.place``.

    Raises:
        InputError: Too few views, or none that a lens explains.
    """
    lenses = require_choices(models, folds)
    if len(views) < MIN_VIEWS:
        raise InputError(
            f"{len(views)} views of the board are too few for intrinsics; at least {MIN_VIEWS}, "
            "better 20, from different sides and tilted by 20 to 45 degrees"
        )
    fitted = fit_lenses(views, lenses)
    kept, outliers = list(fitted.views), list(fitted.outliers)
    scores = score_lenses(views, fitted, folds, progress)
    chosen = next(score for score in scores if score.within_one_error)
    coverage, tilt = _coverage(kept), _tilts(chosen.fit)
    return Intrinsics(
        chosen,
        tuple(scores),
        tuple(kept),
        tuple(outliers),
        len(chosen.fold_parameters),
        coverage,
        tilt,
        tuple(_remarks(chosen, kept, outliers, coverage, tilt)),
    )


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
    said = []
    width = views[0].size_px[0]
    focal, sigma = chosen.fit.parameters[:2], chosen.fit.sigma[:2]
    spread = _spread_deg(chosen.fit)
    if len(views) < 10:
        said.append(TOO_FEW(count=len(views), what="views of the board", wanted=remarks.MORE_VIEWS))
    if coverage < MIN_COVERAGE:
        said.append(remarks.LENS_COVERAGE(share=coverage))
    if tilt[1] < MIN_TILT_DEG:
        reason = f"no view is tilted by more than {tilt[1]:.1f} degrees"
        said.append(remarks.VIEWS_ALIKE(reason=reason))
    elif spread < MIN_TILT_DEG:
        reason = f"all views show the board from one side, within {spread:.1f} degrees"
        said.append(remarks.VIEWS_ALIKE(reason=reason))
    if (sigma > MAX_FOCAL_SIGMA * focal).any():
        said.append(
            remarks.FOCAL_UNCERTAIN(
                percent=100 * float((sigma / focal).max()),
                grave=bool((sigma > LOST_FOCAL_SIGMA * focal).any()),
            )
        )
    usual = MAX_RMS_SHARE * width
    # Views that are outliers are left out, and stand in the report.
    if chosen.heldout_robust_px > usual or not chosen.fit.converged:
        wrong = chosen.heldout_robust_px > WRONG_RMS * usual or not chosen.fit.converged
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
