# SPDX-License-Identifier: Apache-2.0
"""What can be chosen of a colour calibration."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.calibration.press_options import BallPressOptions


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
