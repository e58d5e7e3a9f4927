# SPDX-License-Identifier: Apache-2.0
"""A lens fitted to views from nothing but them: focal lengths to start from, views to leave out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.bundle import BundleFit, fit_bundle
from taccel_lab.calibration.camera.lens import Lens
from taccel_lab.errors import InputError

MIN_VIEWS = 3
OUTLIER_RATIO = 3.0
"""A view whose error is this many times the median of all views is left out."""
_FOCAL_STARTS = (0.35, 0.6, 1.0, 1.8, 3.5)
"""Focal lengths tried, in image widths."""
_START_VIEWS = 6
_FIRST_STEPS = 25
"""Steps after which the starts are compared."""


@dataclass(frozen=True)
class LensFits:
    """Some lenses fitted to the same views."""

    fits: tuple[BundleFit, ...]
    """One of each lens, in the order asked for."""
    views: tuple[BoardView, ...]
    """Views that were fitted."""
    outliers: tuple[str, ...]
    """What is wrong with the others."""


def fit_lenses(views: Sequence[BoardView], lenses: Sequence[Lens]) -> LensFits:
    """Fit every lens to the views that one of them explains, at least two thirds of them.

    That lens is looked for among all focal lengths; the others start from what it and the one
    before found.

    Raises:
        InputError: Too few points for the unknowns, or no pose that explains a view.
    """
    kept, outliers = list(views), []
    lens = next((lens for lens in lenses if lens.name in ("pinhole", "fisheye")), lenses[-1])
    first = _from_any_focal(kept, lens)
    while len(outliers) < len(views) // 3 and len(kept) > MIN_VIEWS:
        errors = first.view_rms_px
        limit = max(OUTLIER_RATIO * float(np.median(errors)), 1e-6)
        worst = int(np.argmax(errors))
        if errors[worst] <= limit:
            break
        outliers.append(
            f"{kept[worst].source}: {errors[worst]:.2f} px off, the median view "
            f"{np.median(errors):.2f} px; the board moved, is bent, or its points are mistaken"
        )
        del kept[worst]
        first = _from_any_focal(kept, lens)
    fits: list[BundleFit] = []
    for other in lenses:
        starts = [_as_start(fit, other) for fit in (*fits[-1:], first)]
        fits.append(first if other is lens else _best_of(kept, other, starts))
    return LensFits(tuple(fits), tuple(kept), tuple(outliers))


def _from_any_focal(views: list[BoardView], lens: Lens) -> BundleFit:
    width, height = views[0].size_px
    starts = []
    for share in _FOCAL_STARTS:
        start = np.zeros(lens.parameter_count)
        start[:4] = share * width, share * width, (width - 1) / 2, (height - 1) / 2
        starts.append(start)
    return _best_of(views, lens, starts)


def _as_start(fit: BundleFit, lens: Lens) -> np.ndarray:
    """Parameters of another lens as far as they mean the same."""
    start = np.zeros(lens.parameter_count)
    both = 4
    if fit.lens.camera_kind == lens.camera_kind:
        both = min(fit.lens.parameter_count, lens.parameter_count)
    start[:both] = fit.parameters[:both]
    return start


def _best_of(views: list[BoardView], lens: Lens, starts: list[np.ndarray]) -> BundleFit:
    """Fit from several starts to some views, then from the best of them to all."""
    step = max(1, len(views) // _START_VIEWS)
    some = views[::step] if len(views[::step]) >= MIN_VIEWS else views
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
