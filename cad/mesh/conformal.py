# SPDX-License-Identifier: Apache-2.0
"""Conformal map between the unit disc and a rounded rectangle, with discs around any point.

With u the harmonic function that equals -log|z| on the outline and v its conjugate, z exp(u + iv)
maps the inside onto the unit disc (P. Henrici, Applied and Computational Complex Analysis III,
section 16.5). u is fitted as the real part of an even polynomial; the inverse is the Taylor series
whose coefficients are the Fourier coefficients of the outline over the boundary angle.

Moebius maps of the disc onto itself move its centre to any point and keep all angles: a polar grid
becomes a grid around that point which still ends on the outline and never folds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

_TERMS = 40
_SERIES = 160
_SAMPLES = 4096
_MAX_ASPECT = 1.35
"""Longer outlines are compressed to this aspect first: a conformal map of a long shape crowds."""


@dataclass(frozen=True)
class DiscMap:
    """The map of one rounded rectangle; plan points are complex x + iy [mm]."""

    stretch: complex
    """Factors along x (real part) and y (imaginary part) from the mapped shape to the plan."""
    scale_mm: float
    log_coefficients: np.ndarray
    """Real coefficients of (z / scale)^(2k) in u + iv."""
    series: np.ndarray
    """Real coefficients of w^(2k + 1) in the inverse map [mm]."""
    outline_mm: np.ndarray
    """Plan points of a quarter of the outline, from the x axis to the y axis, complex."""
    outline_angle: np.ndarray
    """Boundary angle of those points [rad], 0 to pi / 2."""

    def disc_from_plan(self, z: np.ndarray) -> np.ndarray:
        """Disc points of plan points, complex, any shape."""
        q = np.real(z) / self.stretch.real + 1j * np.imag(z) / self.stretch.imag
        return q * np.exp(np.polyval(self.log_coefficients[::-1], (q / self.scale_mm) ** 2))

    def plan_from_disc(self, w: np.ndarray) -> np.ndarray:
        """Plan points [mm] of disc points, complex, any shape."""
        q = w * np.polyval(self.series[::-1], w * w)
        return np.real(q) * self.stretch.real + 1j * np.imag(q) * self.stretch.imag

    def slope_mm(self, w: complex) -> complex:
        """Derivative of the plan point [mm] by the disc point ``w``, the mean of both axes."""
        odd = 2 * np.arange(len(self.series)) + 1
        local = complex(np.polyval((odd * self.series)[::-1], w * w))
        return local * (self.stretch.real * self.stretch.imag) ** 0.5

    def angle_of_corner(self) -> float:
        """Boundary angle of the middle of the corner arc in the first quadrant [rad]."""
        along = np.diff(self.outline_mm)
        arc = np.flatnonzero(np.real(along) * np.imag(along) < 0)
        middle = 0.5 * (self.outline_mm[arc[0]] + self.outline_mm[arc[-1] + 1])
        nearest = np.argmin(np.abs(self.outline_mm - middle))
        return float(self.outline_angle[nearest])


def disc_automorphism(zeta: np.ndarray, center: complex) -> np.ndarray:
    """The Moebius map of the unit disc onto itself that takes 0 to ``center``."""
    return (zeta + center) / (1 + np.conj(center) * zeta)


@lru_cache(maxsize=32)
def disc_map(half_x_mm: float, half_y_mm: float, radius_mm: float) -> DiscMap:
    """Map for a rectangle of the given half lengths and corner radius [mm]."""
    outline = _quarter_outline(half_x_mm, half_y_mm, radius_mm)
    aspect = half_x_mm / half_y_mm
    stretch = complex(max(1.0, aspect / _MAX_ASPECT), max(1.0, 1 / (aspect * _MAX_ASPECT)))
    quarter = np.real(outline) / stretch.real + 1j * np.imag(outline) / stretch.imag
    scale = float(np.abs(quarter).max())
    powers = (quarter[:, None] / scale) ** (2 * np.arange(_TERMS))
    log_coefficients = np.linalg.lstsq(powers.real, -np.log(np.abs(quarter)), rcond=None)[0]
    angle = np.angle(quarter) + (powers.imag @ log_coefficients)
    # The fit wavers by its residual; a running maximum keeps the angle monotone.
    angle = np.maximum.accumulate(np.clip(angle, 0, np.pi / 2))
    angle[0], angle[-1] = 0.0, np.pi / 2
    t = 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    folded = np.minimum(t % np.pi, np.pi - t % np.pi)
    x = np.interp(folded, angle, quarter.real) * np.where(np.cos(t) < 0, -1, 1)
    y = np.interp(folded, angle, quarter.imag) * np.where(np.sin(t) < 0, -1, 1)
    series = (np.fft.fft(x + 1j * y) / _SAMPLES).real[1 : 2 * _SERIES : 2]
    return DiscMap(stretch, scale, log_coefficients, series, outline, angle)


def _quarter_outline(half_x: float, half_y: float, radius: float) -> np.ndarray:
    """Outline from the x axis to the y axis [mm], complex, ends included."""
    angle = 0.5 * np.pi * np.linspace(0, 1, 200)
    t = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0, 1, 300))
    straight_y = half_x + 1j * (half_y - radius) * t[:-1]
    arc = complex(half_x - radius, half_y - radius) + radius * np.exp(1j * angle)
    straight_x = (half_x - radius) * (1 - t[1:]) + 1j * half_y
    return np.concatenate([straight_y, arc, straight_x])
