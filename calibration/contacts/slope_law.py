# SPDX-License-Identifier: Apache-2.0
"""Slope of a gel under a ball along a radius: what the colours of a press depend on.

Inside the contact the gel has the ball's shape: ``n(r) = r / R``, n being the horizontal part of
the unit normal. Outside it sinks like Hertz's half-space (K. L. Johnson, Contact Mechanics, 1985,
eq. 3.42a, differentiated):

    slope(r) / slope(a) = 2/pi (x asin(1/x) - sqrt(1 - 1/x^2)),   x = r / a,

damped by ``exp(-(r - a) / l)``: a gel bonded to a plate, and all the more one pressed deeply, sinks
over a shorter distance. ``l = sqrt(R^2 - a^2)`` follows our own finite-element presses (bonded pad
of 2.5 R thickness, contact radii of 0.52, 0.74 and 0.91 R) to 0.01 to 0.03 in n out to 2.5 a, where
the half-space is off by 0.04 to 0.22. It is taken a quarter longer (``SINK_IN_SCALE``): colours of
presses on three sensors all ask for more, up to twice as much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

MAX_CONTACT_RATIO = 0.97
"""Largest contact radius that the law takes, in ball radii: at 1 the ball's slope is infinite."""
SINK_IN_SCALE = 1.25
"""Damping length over ``sqrt(R^2 - a^2)``."""
TABLE_STEPS = 280


@dataclass(frozen=True)
class SlopeLaw:
    """Tables over the distance from the press's centre."""

    distance_px: np.ndarray
    """Equally spaced from 0, shape [n]."""
    normal: np.ndarray
    """Horizontal part of the unit normal, 0..1, shape [n]."""
    drop: np.ndarray
    """How far the gel has sunk, in ball radii, shape [n]."""
    blur_px: float
    """Standard deviation of what blurs them."""

    def at(self, distance_px: np.ndarray) -> np.ndarray:
        """``normal`` and ``drop`` at distances from the centre, shape [2, n] of [n]."""
        return self._between(np.stack([self.normal, self.drop]), distance_px)

    def rates(self, distance_px: np.ndarray, wider: SlopeLaw, wider_px: float) -> np.ndarray:
        """How both change with the distance, with the contact's radius, which is ``wider_px`` more
        in ``wider``, and with the blur, shape [3, 2, n] of [n]."""
        both = np.stack([self.normal, self.drop])
        step = self.distance_px[1]
        by_distance = np.gradient(both, step, axis=1)
        by_radius = (np.stack([wider.normal, wider.drop]) - both) / wider_px
        # A Gaussian spreads as heat does: its width's rate is its width times the curvature.
        by_blur = self.blur_px * np.gradient(by_distance, step, axis=1)
        found = self._between(np.concatenate([by_distance, by_radius, by_blur]), distance_px)
        return found.reshape(3, 2, -1)

    def _between(self, tables: np.ndarray, distance_px: np.ndarray) -> np.ndarray:
        position = np.minimum(distance_px / self.distance_px[1], len(self.distance_px) - 1.001)
        low = position.astype(np.intp)
        part = position - low
        return tables[:, low] * (1 - part) + tables[:, low + 1] * part


def hertz_slope(ratio: np.ndarray) -> np.ndarray:
    """Slope of Hertz's half-space outside the contact over that at its rim; ``ratio`` = r/a >= 1"""
    ratio = np.maximum(ratio, 1.0)
    return (2 / np.pi) * (ratio * np.arcsin(1 / ratio) - np.sqrt(1 - 1 / ratio**2))


def slope_law(
    contact_px: float,
    ball_px: float,
    blur_px: float,
    reach_px: float,
    sink_in: float = SINK_IN_SCALE,
) -> SlopeLaw:
    """The law for a contact and a ball of these radii [px], out to ``reach_px``.

    ``blur_px`` is the standard deviation of what blurs the picture; ``sink_in`` scales the damping
    length.
    """
    contact = min(contact_px, MAX_CONTACT_RATIO * ball_px)
    beside = np.sqrt(ball_px**2 - contact**2)
    distance = np.linspace(0.0, reach_px, TABLE_STEPS)
    inside = np.minimum(distance, contact)
    slope = inside / np.sqrt(ball_px**2 - inside**2)
    outside = distance > contact
    slope[outside] *= hertz_slope(distance[outside] / contact) * np.exp(
        -(distance[outside] - contact) / (sink_in * beside)
    )
    step = distance[1]
    sunk = np.cumsum(slope[::-1])[::-1] * (step / ball_px)
    both = np.stack([slope / np.sqrt(1 + slope**2), sunk])
    if blur_px > 0.05 * step:
        both = _blur(both, blur_px / step)
    return SlopeLaw(distance, both[0], both[1], blur_px)


def _blur(both: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian along a ray that goes on through the centre to the other side, where the normal,
    the first of ``both``, leans the other way."""
    reach = min(both.shape[1] - 1, int(4 * sigma) + 2)
    other = both[:, reach:0:-1] * np.array([[-1.0], [1.0]])
    whole = np.concatenate([other, both], axis=1)
    return gaussian_filter1d(whole, sigma, mode="nearest")[:, reach:]
