# SPDX-License-Identifier: Apache-2.0
"""Lenses fitted to views from nothing but them: where to start from, which views to leave out.

OpenCV's calibration gives the start and no more: with a few wrong corners (4 of 576, 30 px off) its
focal lengths are 4.8 px off on average, those of the robust bundle adjustment 0.4 px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.bundle import BundleFit, fit_bundle
from taccel_lab.calibration.camera.lens import Lens
from taccel_lab.errors import InputError

MIN_VIEWS = 3
OUTLIER_RATIO = 3.0
"""A view whose error is this many times the median of all views is left out."""
_FOCAL_SHARES = (0.3, 5.0)
"""Focal lengths, in image widths, between which OpenCV's is believed."""


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

    That lens starts from OpenCV's focal lengths, the others from what it found.

    Raises:
        InputError: Too few points for the unknowns, or no pose that explains a view.
    """
    kept, outliers = list(views), []
    lens = next((lens for lens in lenses if lens.name in ("pinhole", "fisheye")), lenses[-1])
    first = _first_fit(kept, lens)
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
        first = fit_bundle(kept, lens, first.parameters, np.delete(first.poses, worst, axis=0))
    fits = tuple(
        first if other is lens else fit_bundle(kept, other, _as_start(first, other), first.poses)
        for other in lenses
    )
    return LensFits(fits, tuple(kept), tuple(outliers))


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
