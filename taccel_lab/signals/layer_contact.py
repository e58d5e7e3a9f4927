# SPDX-License-Identifier: Apache-2.0
r"""Contact of a gel with a fine surface, given the gel's answer to a coarse one.

Elements of a press are several pixels wide: they know where the gel goes and what carries, not how
it enters the valleys of a knurl. Near the solution the gel answers linearly: other pressures p in
place of the coarse ones p_c move its face by the compliance K of an elastic layer on a rigid back,

    z = z_c - K * (p - p_c),

and what is sought lies under the object, z <= z_o, with p >= 0, and p = 0 where it does not touch:
a linear complementarity problem, the minimum of 1/2 p.Kp + p.(z_o - z_c - K p_c) over p >= 0. It is
solved on the pixels by projected conjugate gradients [Polonsky and Keer 1999, Wear 231:206], K by
Fourier transforms, images as periods. A layer of thickness h without friction on its face has

    K(q) = 2 / (E' q) (2 k sinh 2w - 4 w) / (2 k cosh 2w + 1 + k^2 + 4 w^2),   w = q h, k = 3 - 4 nu

with E' = E / (1 - nu^2) [Vorovich, Aleksandrov and Babeshko 1974]: Boussinesq's half-space for
short waves, squeezed material for long ones. What the coarse solution has of large strains,
friction and the pad's rim stays; only differences go through K. Moves across the press, which
friction resists and an incompressible half-space has none of, are left out.

The pressures of the coarse gel are not p_c itself: recovered at nodes, they reach an element beyond
the contact. Taken as they are, that rim has to be taken away again, the gel rises, the contact
grows: radii of balls were 2 to 5 % too large, and forces as much too small. So the problem is
solved ``SHARPENINGS`` times before, and what it finds, scaled to the coarse force, is taken for
p_c.

Arrays are of numpy on the host and of torch on a GPU: the calls below are those that both have.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.tensors import map_totals

ITERATIONS = 10
"""Iterations of conjugate gradients: with 20 contact radii change by 1e-3 and images by 0.1 dB."""
SHARPENING_ITERATIONS = 5
"""The same of each sharpening, which need not end: with 10 radii of balls change by 1e-3."""
SHARPENINGS = 2
"""How often the coarse pressures are sharpened: after none, one and two, contacts of balls have
1.05, 1.025 and 1.00 to 1.025 times the radius that they have on meshes of six times as many
nodes."""
NOWHERE_M = 1.0
"""Height of an object where there is none."""
_START = 0.1
_TINY = 1e-30


def layer_compliance(
    grid: PixelGrid, young_pa: float, poisson: float, thickness_m: float
) -> np.ndarray:
    """K(q) of the waves of an image [m / Pa], as ``rfft2`` orders them, [height_px, width_px // 2 +
    1]."""
    qx = 2e3 * np.pi * np.fft.rfftfreq(grid.width_px, grid.mm_per_px_x)
    qy = 2e3 * np.pi * np.fft.fftfreq(grid.height_px, grid.mm_per_px_y)
    q = np.hypot(*np.meshgrid(qx, qy))
    plane, k = young_pa / (1 - poisson**2), 3 - 4 * poisson
    # The quotient is 1 beyond, and sinh would overflow.
    w = np.minimum(q * thickness_m, 50.0)
    top = 2 * k * np.sinh(2 * w) - 4 * w
    bottom = 2 * k * np.cosh(2 * w) + 1 + k**2 + 4 * w**2
    flat = 8 * thickness_m * (k - 1) / ((k + 1) ** 2 * plane)
    return np.where(q > 0, 2 / (plane * np.maximum(q, _TINY)) * top / bottom, flat)


def solve_contact(
    compliance: Any,
    object_m: Any,
    coarse_m: Any,
    coarse_pa: Any,
    *,
    smooth_m: Any = None,
    iterations: int = ITERATIONS,
    sharpenings: int = SHARPENINGS,
) -> tuple[Any, Any]:
    """The fine surface and its pressures; always as many iterations, so that nothing waits for the
    device.

    Args:
        compliance: ``layer_compliance``, float32, numpy's or torch's as the others.
        object_m: z of the object's underside [m], [env, row, column]; ``NOWHERE_M`` where there is
            none.
        coarse_m: z of the gel's face in the coarse solution [m], same shape.
        coarse_pa: Contact pressures there [Pa], same shape.
        smooth_m: z of the object that the coarse solution knows; ``object_m`` when None.
        iterations: Of conjugate gradients, after the sharpenings.
        sharpenings: Of the coarse pressures.

    Returns:
        z of the gel's face [m] and contact pressures [Pa], [env, row, column].
    """
    xp = array_library(coarse_pa)
    fft = xp.fft
    if xp is np:
        # A quarter of the time of numpy's on an image of 640 x 480, in single precision as well.
        import scipy.fft as fft

    def moved(pressure: Any) -> Any:
        waves = compliance * fft.rfft2(pressure)
        return fft.irfft2(waves, s=(pressure.shape[-2], pressure.shape[-1]))

    smallest = _START / compliance.max()
    smooth_m = object_m if smooth_m is None else smooth_m
    force, pressure, known_pa = map_totals(coarse_pa), coarse_pa, coarse_pa
    runs = [(smooth_m, SHARPENING_ITERATIONS)] * sharpenings
    for under, count in [*runs, (object_m, iterations)]:
        known_pa = coarse_pa
        open_m = under - coarse_m - moved(known_pa)
        # Pressures wherever there is overlap, so that the first direction is not nothing.
        start = known_pa + smallest * xp.clip(-open_m, min=0)
        # One sample that carries without an object would be all that a direction goes by.
        start = xp.where(under < NOWHERE_M, start, 0.0)
        pressure = _least(xp, moved, open_m, start, count)
        coarse_pa = pressure * (force / xp.clip(map_totals(pressure), min=_TINY))
    found = xp.minimum(coarse_m - moved(pressure - known_pa), object_m)
    # What carries touches; conjugate gradients would need 30 iterations to make it so.
    return xp.where(pressure > 0, object_m, found), pressure


def array_library(array: Any) -> Any:
    """The module whose functions take an array: numpy, or torch, which is then loaded."""
    return np if isinstance(array, np.ndarray) else sys.modules["torch"]


def _least(xp: Any, moved: Callable[[Any], Any], open_m: Any, p: Any, iterations: int) -> Any:
    """Pressures not below zero of the least 1/2 p.Kp + p.open, by projected conjugate gradients."""
    direction = xp.zeros_like(p)
    before = xp.ones_like(p[:, :1, :1])
    keep = none = xp.zeros_like(before)
    whole = xp.ones_like(before)
    for _ in range(iterations):
        gap = moved(p) + open_m
        carries = p > 0
        slope = xp.where(carries, gap, 0.0)
        size = map_totals(slope * slope)
        direction = xp.where(carries, slope + keep * (size / before) * direction, 0.0)
        before = xp.clip(size, min=_TINY)
        step = map_totals(slope * direction) / xp.clip(
            map_totals(moved(direction) * direction), min=_TINY
        )
        p = xp.clip(p - step * direction, min=0)
        # What overlaps without a pressure begins to carry; directions are conjugate no more then.
        joins = (p == 0) & (gap < 0)
        p = xp.where(joins, -step * gap, p)
        keep = xp.where(joins.any(-1, keepdims=True).any(-2, keepdims=True), none, whole)
    return p
