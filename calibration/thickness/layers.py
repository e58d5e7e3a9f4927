# SPDX-License-Identifier: Apache-2.0
"""Bonded layers from thin to thick under one ball: how deep each is pressed until it touches in a
circle, and how it slopes beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.circles.ball_surface import LARGEST_RADII, ball_in_layer
from taccel_lab.calibration.circles.bonded_layer import BondedLayer
from taccel_lab.geometry import PixelGrid

THINNEST_MM, THICKEST_MM = 1.0, 16.0
"""Layers that are compared; a thicker one is a half-space within three contact radii."""
LAYERS, STEPS = 9, 200
"""Layers that are solved, and thicknesses between them."""
DEEPEST = 0.7
"""Of a layer's thickness, that a ball's cap may take."""
RADII = 3.2
"""Contact radii around the ball that are solved."""


@dataclass(frozen=True)
class LayerFamily:
    """Layers of ``thickness_mm``, shape [layer], rising evenly in its logarithm."""

    thickness_mm: np.ndarray
    depth_mm: np.ndarray
    """Depth of the ball in each, shape [layer]."""
    away_radii: np.ndarray
    """Where slopes are known, contact radii from the ball's axis, shape [place]."""
    slope: np.ndarray
    """Slopes towards the ball there, shape [layer, place]."""

    @classmethod
    @lru_cache(maxsize=8)  # Blocks that are fitted to the same presses ask for the same layers.
    def under(cls, radius_mm: float, ball_mm: float, poisson_ratio: float) -> LayerFamily:
        """Layers that a ball touches in a circle of ``radius_mm``."""
        touched = min(radius_mm, LARGEST_RADII * ball_mm)
        cap_mm = ball_mm - np.sqrt(ball_mm**2 - touched**2)
        thinnest = min(max(THINNEST_MM, cap_mm / DEEPEST), 0.9 * THICKEST_MM)
        nodes = np.geomspace(thinnest, THICKEST_MM, LAYERS)
        # A pixel is a 24th of the radius: heights are solved on a 16th and smooth.
        radius_px = 24.0
        pitch = radius_mm / radius_px
        half = int(np.ceil(RADII * radius_px))
        grid = PixelGrid(2 * half + 1, 2 * half + 1, pitch, pitch)
        circle = ContactCircle(float(half), float(half), radius_px)
        depths, slopes = [], []
        for node in nodes:
            layer = BondedLayer(float(node), poisson_ratio)
            depth, rise = ball_in_layer(circle, ball_mm, grid, layer)
            depths.append(depth)
            slopes.append(np.gradient(rise[half, half:], pitch))
        thickness = np.geomspace(nodes[0], nodes[-1], STEPS)
        at = np.log(thickness)
        return cls(
            thickness,
            CubicSpline(np.log(nodes), depths)(at),
            np.arange(half + 1) / radius_px,
            CubicSpline(np.log(nodes), slopes)(at),
        )

    def slopes(self, away_radii: np.ndarray) -> np.ndarray:
        """Slopes at these places, shape [layer, place]."""
        return np.array([np.interp(away_radii, self.away_radii, row) for row in self.slope])
