# SPDX-License-Identifier: Apache-2.0
"""Cross-validation of the colour model: fits without some presses, and what they disagree about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import ColorFrame
from taccel_lab.calibration.color.network_fit import ColorFit, fit_color_model
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.progress import Progress, silent

TASK = "fitting without some of the presses"


@dataclass(frozen=True)
class FoldResult:
    """Fits of which each left out some presses."""

    fits: list[ColorFit]
    left_out: list[list[int]]
    """Indices of the presses that each fit never saw."""

    def fit_without(self, index: int) -> ColorFit:
        """The fit that never saw a press."""
        for fit, indices in zip(self.fits, self.left_out, strict=True):
            if index in indices:
                return fit
        raise InputError(f"no fold left press {index} out")

    def spread_levels(self, frame: ColorFrame, pixel_idx: np.ndarray) -> np.ndarray:
        """Standard deviation of the fits' renders at pixels of a press [levels], shape [n, 3].

        What is rendered is background and change together, as each fit has its own background.
        """
        surface = frame.surface
        renders = [
            fit.background.reshape(-1, 3)[pixel_idx]
            + fit.model.predict_pixels(
                pixel_idx,
                surface.normals.reshape(-1, 3)[pixel_idx],
                surface.displacement_mm().reshape(-1)[pixel_idx],
                surface.rest_normals.reshape(-1, 3)[pixel_idx],
            )
            for fit in self.fits
        ]
        return np.std(renders, axis=0, ddof=1)


def fold_fits(
    frames: Sequence[ColorFrame],
    background: np.ndarray,
    grid: PixelGrid,
    options: ColorFitOptions,
    *,
    folds: int,
    mask: np.ndarray | None = None,
    progress: Progress = silent,
) -> FoldResult:
    """``folds`` fits; fit k leaves out every press whose index modulo ``folds`` is k."""
    if not 2 <= folds <= len(frames):
        raise InputError(f"folds must lie in 2..{len(frames)} (the number of presses), got {folds}")
    fits, left_out = [], []
    for k in range(folds):
        kept = [frame for i, frame in enumerate(frames) if i % folds != k]

        def tell(_: str, step: int, steps: int, k: int = k) -> None:
            progress(TASK, k * steps + step, folds * steps)

        fits.append(fit_color_model(kept, background, grid, options, mask=mask, progress=tell))
        left_out.append(list(range(k, len(frames), folds)))
    return FoldResult(fits, left_out)
