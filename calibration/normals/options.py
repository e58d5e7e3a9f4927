# SPDX-License-Identifier: Apache-2.0
"""Options of a fit of normals, and the settings of its networks."""

from __future__ import annotations

import math
from dataclasses import dataclass

from taccel_lab.calibration.press_options import (
    UNTOUCHED_RADII,
    BallPressOptions,
    NetworkTraining,
    require_settings,
)
from taccel_lab.guards import require_range

MOST_SYNTHETIC = 10_000
"""Synthetic presses; each takes a tenth of a second."""
RIM_RADII = 0.98
"""Contact radii within which a pixel lies in the contact, as well as circles are known."""
SINK_IN_RADII = 1.03
"""Contact radii beyond which it surely lies outside."""


@dataclass(frozen=True, kw_only=True)
class NormalTraining(NetworkTraining):
    """Options of the fit of the networks from colour to slope."""

    synthetic_presses: int = 160
    """Synthetic presses of other tools in the training, besides the captured balls. Without them
    (0) edges and walls read much too flat."""
    steps: int = 500
    """Optimiser steps; each network keeps its best ones."""


@dataclass(frozen=True, kw_only=True)
class NormalOptions(NormalTraining, BallPressOptions):
    """Settings of ``calibrate_normals``."""


@dataclass(frozen=True, kw_only=True)
class InverseFitOptions(NormalTraining):
    """Settings of the networks and their fit."""

    members: int = 4
    hidden: tuple[int, ...] = (64, 64, 64)
    batch_pixels: int = 1024
    """Pixels a member sees in a step."""
    learning_rate: float = 3e-2
    disc_pixels: int = 3000
    """Pixels drawn of each press within the contact."""
    sink_in_pixels: int = 1500
    """Pixels between the contact and the resting face."""
    flat_pixels: int = 700
    """Where the gel is at rest."""
    zooms: int = 3
    """Zooms at which each press is seen; the first is 1."""
    synthetic_pixels: int = 4000
    """Pixels drawn of each synthetic press."""
    synthetic_share: float = 0.6
    """Share of synthetic presses in each batch."""

    def __post_init__(self) -> None:
        counts = ("members", "steps", "batch_pixels", "disc_pixels", "flat_pixels", "zooms")
        require_settings(self, "normal model", counts, self.learning_rate, 1.0)
        require_range("synthetic_presses", self.synthetic_presses, 0, MOST_SYNTHETIC)

    @property
    def rings(self) -> tuple[tuple[float, float, int], ...]:
        """Contact radii between which pixels of a press are drawn, and how many."""
        return (
            (0.0, RIM_RADII, self.disc_pixels),
            (SINK_IN_RADII, UNTOUCHED_RADII, self.sink_in_pixels),
            (UNTOUCHED_RADII, math.inf, self.flat_pixels),
        )
