# SPDX-License-Identifier: Apache-2.0
"""How thick the gel is, told by presses whose travel a stage has measured.

A circle says how deep the ball lies below its rim, travel how deep it lies below the untouched
face; between the two the rim has sunk, the further the thicker the gel is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.circles.ball_surface import (
    LARGEST_RADII,
    LAYER_SHARE,
    deeper_per_mm,
)
from taccel_lab.calibration.thickness.layers import LayerFamily

TOUCH_MM = 0.05
"""Standard deviation of where a stage's first touch is taken to be [mm], the same for all presses:
a ball touches so little at first that half of that shows neither in an image nor in a force."""
MOST_SOLVED = 3
"""Contacts of one ball that are solved; the others lie between."""


@dataclass(frozen=True)
class TravelPress:
    """A ball press of measured travel."""

    travel_mm: float
    radius_mm: float
    """Of the contact."""
    radius_sigma_mm: float
    ball_mm: float


def depths_in(
    presses: Sequence[TravelPress], thickness_mm: np.ndarray, poisson_ratio: float
) -> np.ndarray:
    """Depth [mm] at which each press's ball touches layers in its circle, shape [press, layer]."""
    found = np.empty((len(presses), len(thickness_mm)))
    balls = np.array([press.ball_mm for press in presses])
    for ball in np.unique(balls):
        own = [i for i, press in enumerate(presses) if press.ball_mm == ball]
        radii = np.array([presses[i].radius_mm for i in own])
        solved = np.unique(np.quantile(radii, np.linspace(0, 1, min(MOST_SOLVED, len(own)))))
        # Depths go nearly with the square of the contact.
        bends = []
        for radius in solved:
            layers = LayerFamily.under(float(radius), float(ball), poisson_ratio)
            known = np.interp(np.log(thickness_mm), np.log(layers.thickness_mm), layers.depth_mm)
            bends.append(known / radius**2)
        for i, radius in zip(own, radii, strict=True):
            at = [np.interp(radius, solved, column) for column in np.transpose(bends)]
            found[i] = np.array(at) * radius**2
    return found


def log_likelihood(
    presses: Sequence[TravelPress], thickness_mm: np.ndarray, poisson_ratio: float
) -> np.ndarray:
    """Of each thickness, shape as ``thickness_mm``, but for a constant.

    Radii err press by press; first touch and the layer's law are off in all of them alike.
    """
    depths = depths_in(presses, thickness_mm, poisson_ratio)
    travel = np.array([press.travel_mm for press in presses])
    found = np.empty(len(thickness_mm))
    for k, depth in enumerate(depths.T):
        own = [
            deeper_per_mm(min(p.radius_mm, LARGEST_RADII * p.ball_mm), p.ball_mm, d)
            * p.radius_sigma_mm
            for p, d in zip(presses, depth, strict=True)
        ]
        law = LAYER_SHARE * depth
        covariance = np.diag(np.square(own)) + TOUCH_MM**2 + np.outer(law, law)
        off = travel - depth
        found[k] = -0.5 * off @ np.linalg.solve(covariance, off)
        found[k] -= 0.5 * np.linalg.slogdet(covariance)[1]
    return found
