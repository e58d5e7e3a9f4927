# SPDX-License-Identifier: Apache-2.0
"""Settings of one fit of the colour network."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.calibration.color.options import ColorTraining
from taccel_lab.errors import InputError
from taccel_lab.files.seed import require_seed
from taccel_lab.networks.color_settings import INPUT_NAMES
from taccel_lab.networks.position_encoding import require_bands


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
        require_bands("color model", self.position_bands)
        require_seed(self.seed)
