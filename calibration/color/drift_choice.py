# SPDX-License-Identifier: Apache-2.0
"""Whether the light's drift has to be taken off the frames, by what predicts left-out presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.color.fit_options import SHORT_FIT
from taccel_lab.calibration.color.folds import fold_fits
from taccel_lab.calibration.color.frames import ColorFrame, frame_drift
from taccel_lab.calibration.color.network_fit import disc_l1
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

NEEDED_GAIN = 0.1
"""Drift is taken off when that lowers the error of left-out presses by this share: where it does
not matter, leaving it in averages the light over all captures."""


@dataclass(frozen=True)
class DriftChoice:
    """What was chosen, and the errors that it rests on."""

    remove: bool
    disc_l1_off: float | None = None
    """L1 in the discs of left-out presses with the drift left in [levels]; None: not compared."""
    disc_l1_on: float | None = None
    """The same with the drift taken off the frames and put on the renders."""
    reason: str = ""


def choose_drift(
    frames: Sequence[ColorFrame],
    background: np.ndarray,
    grid: PixelGrid,
    *,
    mask: np.ndarray | None = None,
    seed: int = 0,
) -> DriftChoice:
    """Compare short fits with and without drift, each on the presses that it left out."""
    if len(frames) < 4:
        return DriftChoice(False, reason=f"{len(frames)} presses are too few to compare")
    losses = {}
    for remove in (False, True):
        options = replace(SHORT_FIT, remove_drift=remove, seed=seed)
        try:
            found = fold_fits(frames, background, grid, options, folds=2, mask=mask)
            values = []
            for i, frame in enumerate(frames):
                fit = found.fit_without(i)
                drift = frame_drift(frame, background, grid, mask, options)
                values.append(disc_l1(fit.model, frame, fit.background, drift, grid, mask))
        except InputError as error:
            return DriftChoice(False, losses.get(False), None, str(error))
        losses[remove] = float(np.mean(values))
    remove = losses[True] < (1 - NEEDED_GAIN) * losses[False]
    return DriftChoice(remove, losses[False], losses[True])
