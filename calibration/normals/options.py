# SPDX-License-Identifier: Apache-2.0
"""What can be chosen of a calibration of normals."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.calibration.press_options import BallPressOptions


@dataclass(frozen=True, kw_only=True)
class NormalTraining:
    """Options of the fit of the networks."""

    position_bands: int = 0
    """Bands of the positional encoding among the features: sines and cosines of the pixel's
    position. 0 to 8; 0 gives the networks the position alone."""
    synthetic_presses: int = 160
    """Synthetic presses of other tools in the training, besides the captured balls. Without them
    (0) edges and walls read much too flat."""
    steps: int = 500
    """Optimiser steps; each network keeps its best ones."""
    seed: int = 0
    """Seed of the pixel draw, the initial weights and the batches."""


@dataclass(frozen=True, kw_only=True)
class NormalOptions(NormalTraining, BallPressOptions):
    """Settings of ``calibrate_normals``."""
