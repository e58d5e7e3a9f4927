# SPDX-License-Identifier: Apache-2.0
"""What can be chosen of a colour calibration, and the settings of one fit of its network."""

from __future__ import annotations

import math
from dataclasses import dataclass

from taccel_lab.calibration.press_options import UNTOUCHED_RADII, BallPressOptions
from taccel_lab.errors import InputError
from taccel_lab.guards import require_range, require_seed
from taccel_lab.networks.color_settings import INPUT_NAMES
from taccel_lab.networks.settings import MAX_BANDS

DISC_RADII = 1.3
"""Contact radii within which the colours of a contact and its rim lie."""


@dataclass(frozen=True, kw_only=True)
class ColorTraining:
    """Options of the fit of a network."""

    position_bands: int = 0
    """Bands of the positional encoding: sines and cosines of the pixel's position, for light
    that changes within parts of the image. 0 to 8; 0 gives the network the position alone."""
    steps: int = 400
    """Optimiser steps of the fit."""
    batch_pixels: int = 1024
    """Batch size in pixels; it sets the time of a fit."""
    seed: int = 0
    """Seed of the pixel draw, the initial weights and the batches."""


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
        for name in ("steps", "batch_pixels", "disc_pixels", "ring_pixels", "far_pixels"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("learning_rate", "huber_levels"):
            if not 0 < getattr(self, name) < 1e3:
                raise InputError(f"{name} must be positive, got {getattr(self, name)}")
        require_range("color model position_bands", self.position_bands, 0, MAX_BANDS)
        require_seed(self.seed)

    @property
    def rings(self) -> tuple[tuple[float, float, int], ...]:
        """Contact radii between which pixels of a frame are drawn, and how many."""
        return (
            (0.0, DISC_RADII, self.disc_pixels),
            (DISC_RADII, UNTOUCHED_RADII, self.ring_pixels),
            (UNTOUCHED_RADII, math.inf, self.far_pixels),
        )
