# SPDX-License-Identifier: Apache-2.0
"""What can be chosen of a calibration of normals."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.calibration.light.drift_choice import DriftMode
from taccel_lab.calibration.press_options import BallPressOptions


@dataclass(frozen=True, kw_only=True)
class NormalTraining:
    """What can be chosen of the fit of the networks."""

    position_bands: int = 0
    """Bands of the positional encoding among the features: sines and cosines of the pixel's place.
    0 to 8; 0 gives the networks the place alone."""
    practice: int = 160
    """Simulated presses of other tools that the networks practise on besides the captured balls; 0
    leaves them out, and edges and walls are then read much too flat."""
    steps: int = 2000
    """Optimiser steps; each network keeps its best ones."""
    seed: int = 0
    """Seed of the pixel draw, the initial weights and the batches."""


@dataclass(frozen=True, kw_only=True)
class NormalOptions(NormalTraining, BallPressOptions):
    """Settings of ``calibrate_normals``."""

    drift: DriftMode = "auto"
    """Bring the light of each frame to the background's first; auto does it where that takes away
    at least a quarter of the difference between untouched gel and background."""
