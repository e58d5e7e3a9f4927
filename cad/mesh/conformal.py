# SPDX-License-Identifier: Apache-2.0
"""Conformal map between the unit disc and a pad's outline, with discs around any point.

With u the harmonic function that equals -log|z| on the outline and v its conjugate, z exp(u + iv)
maps the inside onto the unit disc (P. Henrici, Applied and Computational Complex Analysis III,
section 16.5). u is fitted as the real part of a polynomial; the inverse is the Taylor series
whose coefficients are the Fourier coefficients of the outline over the boundary angle.

Moebius maps of the disc onto itself move its centre to any point and keep all angles: a polar grid
becomes a grid around that point which still ends on the outline and never folds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from taccel_lab.cad.parts.pad_outline import PadOutline
from taccel_lab.processes.process_pool import one_blas_thread

_TERMS = 80
_SERIES = 320
_SAMPLES = 4096
_MAX_ASPECT = 1.35
"""Longer outlines are compressed to this aspect first: a conformal map of a long shape crowds."""


@dataclass(frozen=True)
class DiscMap:
    """The map of one outline; plan points are complex x + iy [mm]."""

    center: complex
    """Plan point that goes to the disc's centre."""
    stretch: complex
    """Factors along x (real part) and y (imaginary part) from the mapped shape to the plan."""
    scale_mm: float
    log_coefficients: np.ndarray
    """Complex coefficients of (z / scale)^k in u + iv."""
    series: np.ndarray
    """Complex coefficients of w^k in the inverse map [mm]."""
    outline_mm: np.ndarray
    """Plan points of the outline, counter-clockwise, complex."""

    def disc_from_plan(self, z: np.ndarray) -> np.ndarray:
        """Disc points of plan points, complex, any shape."""
        offset = z - self.center
        q = np.real(offset) / self.stretch.real + 1j * np.imag(offset) / self.stretch.imag
        return q * np.exp(np.polyval(self.log_coefficients[::-1], q / self.scale_mm))

    def plan_from_disc(self, w: np.ndarray) -> np.ndarray:
        """Plan points [mm] of disc points, complex, any shape."""
        q = np.polyval(self.series[::-1], w)
        return self.center + np.real(q) * self.stretch.real + 1j * np.imag(q) * self.stretch.imag

    def slope_mm(self, w: complex) -> complex:
        """Derivative of the plan point [mm] by the disc point ``w``, the mean of both axes."""
        order = np.arange(1, len(self.series))
        local = complex(np.polyval((order * self.series[1:])[::-1], w))
        return local * (self.stretch.real * self.stretch.imag) ** 0.5


def disc_automorphism(zeta: np.ndarray, center: complex) -> np.ndarray:
    """The Moebius map of the unit disc onto itself that takes 0 to ``center``."""
    return (zeta + center) / (1 + np.conj(center) * zeta)


@lru_cache(maxsize=32)
def disc_map(outline: PadOutline) -> DiscMap:
    """Map for an outline, from the centre of its bounding rectangle."""
    low, high = outline.bounds_mm()
    center = complex(*(low + high) / 2)
    plan = outline.at_mm(_lengths(outline))[0] @ [1, 1j]
    aspect = float((high - low)[0] / (high - low)[1])
    stretch = complex(max(1.0, aspect / _MAX_ASPECT), max(1.0, 1 / (aspect * _MAX_ASPECT)))
    q = np.real(plan - center) / stretch.real + 1j * np.imag(plan - center) / stretch.imag
    scale = float(np.abs(q).max())
    powers = (q[:, None] / scale) ** np.arange(_TERMS)
    basis = np.concatenate([powers.real, -powers.imag[:, 1:]], axis=1)
    with one_blas_thread():
        found = np.linalg.lstsq(basis, -np.log(np.abs(q)), rcond=None)[0]
    coefficients = found[:_TERMS] + 1j * np.concatenate([[0.0], found[_TERMS:]])
    # Counter-clockwise from the first point on; the fit wavers by its residual, and a running
    # maximum keeps the angle monotone.
    angle = np.unwrap(np.angle(q)) + (powers @ coefficients).imag
    angle = np.maximum.accumulate(angle)
    angle = np.append(angle, angle[0] + 2 * np.pi)
    closed = np.append(q, q[0])
    t = angle[0] + 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    around = np.interp(t, angle, closed.real) + 1j * np.interp(t, angle, closed.imag)
    order = np.arange(_SERIES)
    series = np.fft.fft(around)[:_SERIES] / _SAMPLES * np.exp(-1j * order * angle[0])
    return DiscMap(center, stretch, scale, coefficients, series, plan)


def _lengths(outline: PadOutline) -> np.ndarray:
    """Lengths along the outline [mm], denser on short arcs and towards the ends of sides."""
    starts = np.concatenate([[0.0], np.cumsum(outline.piece_lengths_mm)])
    arcs, sides = np.linspace(0, 1, 200)[:-1], 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 300)[:-1])
    return np.concatenate([
        starts[k] + outline.piece_lengths_mm[k] * (sides if k % 2 else arcs)
        for k in range(len(starts) - 1)
    ])  # fmt: skip
