# SPDX-License-Identifier: Apache-2.0
"""Options of a fit of colours, and its settings."""

from __future__ import annotations

import math
from dataclasses import dataclass

from taccel_lab.calibration.press_options import (
    UNTOUCHED_RADII,
    BallPressOptions,
    NetworkTraining,
    require_between,
    require_settings,
)
from taccel_lab.networks.color_settings import INPUT_NAMES

DISC_RADII = 1.3
"""Contact radii within which the colours of a contact and its rim lie."""


@dataclass(frozen=True, kw_only=True)
class ColorTraining(NetworkTraining):
    """Options of the fit of a colour model."""

    steps: int = 400
    """Optimiser steps of the fit."""
    batch_pixels: int = 1024
    """Batch size in pixels; it sets the time of a fit."""


@dataclass(frozen=True, kw_only=True)
class ColorOptions(ColorTraining, BallPressOptions):
    """Settings of ``calibrate_color``."""

    cache: bool = True
    """Whether to use the user's cache folder for contacts."""
    table: bool = True
    """Whether to fit Taxim's table too. The report shows its figures; polycalib.npz beside it is
    for `taccel-lab export --to taxim --table`."""


@dataclass(frozen=True, kw_only=True)
class ColorFitOptions(ColorTraining):
    """Settings of one fit; the defaults take some seconds on one CPU thread."""

    inputs: tuple[str, ...] = INPUT_NAMES
    hidden: tuple[int, ...] = (64, 64, 64)
    learning_rate: float = 2e-2
    huber_levels: float = 2.0
    """Error from which on the loss grows linearly, as images are scored [levels]."""
    disc_pixels: int = 6000
    """Pixels drawn per frame within 1.3 contact radii."""
    ring_pixels: int = 4000
    """Pixels drawn per frame between 1.3 and 2.5 contact radii."""
    far_pixels: int = 1500
    """Pixels drawn per frame beyond 2.5 contact radii."""

    def __post_init__(self) -> None:
        counts = ("steps", "batch_pixels", "disc_pixels", "ring_pixels", "far_pixels")
        require_settings(self, "color model", counts, self.learning_rate, 1e3)
        require_between("huber_levels", self.huber_levels, 1e3)

    @property
    def rings(self) -> tuple[tuple[float, float, int], ...]:
        """Contact radii between which pixels of a frame are drawn, and how many."""
        return (
            (0.0, DISC_RADII, self.disc_pixels),
            (DISC_RADII, UNTOUCHED_RADII, self.ring_pixels),
            (UNTOUCHED_RADII, math.inf, self.far_pixels),
        )
