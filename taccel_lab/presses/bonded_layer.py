# SPDX-License-Identifier: Apache-2.0
"""Forces of a rigid ball or punch on a thin elastic layer that is bonded to a rigid base.

Small strains, no friction, any thickness and Poisson's ratio, by an integral equation. The force is
linear in Young's modulus, so one division inverts it.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_positive, require_range

ToolKind = Literal["sphere", "cylinder", "flat"]

_KERNEL_NODES = 240
_KERNEL_END = 24.0
"""Where 1 - L(x) has fallen below 1e-12."""


def layer_force_n(
    kind: ToolKind,
    depth_mm: np.ndarray,
    radius_mm: float,
    thickness_mm: float,
    poisson_ratio: float,
    young_modulus_pa: float = 1.0,
) -> np.ndarray:
    """Force of a tool on a bonded layer of any thickness [N], from the exact linear solution.

    For a ball and for a flat round punch (``cylinder``) the contact problem is a Fredholm equation
    of the second kind, phi(t) - (2/pi) int_0^a phi(s) int_0^inf (1 - L(k h)) cos(k s) cos(k t) dk
    ds = G(t)/C, C = 2 (1-nu^2)/E, with the layer's compliance L(x) = (2 q sinh 2x - 4x) / (2 q cosh
    2x + 1 + q^2 + 4x^2), q = 3 - 4 nu. G = 2 d/pi of a punch, and of a ball 2/pi (d - t/2 ln((R +
    t)/(R - t))), whose contact radius a follows from phi(a) = 0. F = 2 pi int_0^a phi dt.
    Lebedev and Ufliand (1958); Hayes, Keer, Herrmann and Mockros, Journal of Biomechanics 5 (1972);
    Vorovich, Aleksandrov and Babeshko (1974) for L. A plate (``flat``) larger than the layer
    squeezes it uniformly only if it is free to slide and bulge; here its stiffness is that of a
    laterally confined layer, E (1-nu) / ((1+nu) (1-2 nu)) A/h with A = ``pi radius_mm^2``.

    Args:
        kind: Of the tool.
        depth_mm: Depth past first touch [mm], any shape, >= 0.
        radius_mm: Of the ball or the punch; for ``flat`` that of the disc of the layer's area [mm].
        thickness_mm: Of the layer [mm].
        poisson_ratio: 0 to 0.5, both allowed.
        young_modulus_pa: Of the layer [Pa].
    """
    depth = np.asarray(depth_mm, dtype=np.float64)
    if not np.isfinite(depth).all() or (depth < 0).any():
        raise InputError("depths must be finite and not negative [mm]")
    for name, value in (("radius", radius_mm), ("thickness", thickness_mm)):
        require_positive(f"the {name}", value, "mm")
    require_range("Poisson's ratio of a layer", poisson_ratio, 0.0, 0.5)
    if kind == "flat":
        nu = poisson_ratio
        if nu >= 0.5:
            raise InputError("a confined layer of Poisson's ratio 0.5 cannot be squeezed")
        modulus = young_modulus_pa * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
        return modulus * math.pi * radius_mm**2 * depth / thickness_mm * 1e-6
    if kind == "cylinder":
        _, phi, weights = _solve(radius_mm, thickness_mm, poisson_ratio, None)
        # phi is for d = 1 mm and C = 1 / Pa; 1e-6: mm^2 to m^2.
        factor = young_modulus_pa / (2 * (1 - poisson_ratio**2))
        return 2 * math.pi * factor * float(weights @ phi[:-1]) * depth * 1e-6
    flat = depth.ravel()
    if not len(flat) or flat.max() == 0:
        return np.zeros_like(depth)
    if flat.max() >= radius_mm:
        raise InputError(
            f"a ball of {radius_mm:g} mm radius at a depth of {flat.max():g} mm is past its "
            "equator; the contact of small strains ends there"
        )
    # The radius of contact is the parameter: depth and force of each come from one linear solve.
    depths, forces = _ball_curve(radius_mm, thickness_mm, poisson_ratio, float(flat.max()))
    # F / d^1.5 is smooth down to first touch; the force itself is not.
    ratio = np.interp(flat, depths, forces / depths**1.5)
    return young_modulus_pa * (ratio * flat**1.5).reshape(depth.shape)


def layer_young_modulus_pa(
    kind: ToolKind,
    depth_mm: np.ndarray,
    force_n: np.ndarray,
    radius_mm: float,
    thickness_mm: float,
    poisson_ratio: float,
) -> float:
    """Young's modulus [Pa] of force-depth points of a layer: the median over the points.

    Points at depth 0 are left out.
    """
    depth, force = np.asarray(depth_mm, dtype=float), np.asarray(force_n, dtype=float)
    usable = depth > 0
    if not usable.any():
        raise InputError("no point of the record lies below first touch (depth above 0 mm)")
    unit = layer_force_n(kind, depth[usable], radius_mm, thickness_mm, poisson_ratio)
    return float(np.median(force[usable] / unit))


def _ball_curve(
    radius_mm: float, thickness_mm: float, poisson_ratio: float, deepest_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Depths [mm], rising past ``deepest_mm``, and the forces [N] at them for 1 Pa."""
    factor = 1e-6 / (2 * (1 - poisson_ratio**2))
    depths, forces = [], []
    # A thin layer lets the ball in further for the same contact: a <= sqrt(2 R d) at any thickness.
    a = 0.02 * math.sqrt(radius_mm * deepest_mm)
    while not depths or (depths[-1] < deepest_mm and a < 0.999 * radius_mm):
        unit, shape, weights = _solve(a, thickness_mm, poisson_ratio, radius_mm)
        d = -float(shape[-1] / unit[-1])
        depths.append(d)
        forces.append(2 * math.pi * factor * float(weights @ (d * unit + shape)[:-1]))
        a *= 1.06
    return np.array(depths), np.array(forces)


def _solve(
    a_mm: float, thickness_mm: float, poisson_ratio: float, ball_mm: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve the integral equation for contact radius a.

    Returns the solutions for G = 2/pi (depth 1 mm) and for the ball's shape (the same where there
    is no ball), at the quadrature's nodes and, last, at t = a; and the quadrature's weights [mm].
    """
    count = 24 + int(8 * a_mm / thickness_mm)
    nodes, weights = _gauss_nodes(count)
    t = 0.5 * a_mm * (nodes + 1)
    weights = 0.5 * a_mm * weights
    at = np.append(t, a_mm)
    x, wx = _kernel_quadrature()
    deficit = wx * (1 - _compliance(x, poisson_ratio))
    cosines = np.cos(np.outer(at / thickness_mm, x))
    kernel = 2 / (math.pi * thickness_mm) * (cosines * deficit) @ cosines.T
    system = np.eye(count) - kernel[:-1, :-1] * weights
    right = [np.full(len(at), 2 / math.pi)]
    if ball_mm is not None:
        drop = 0.5 * at * np.log((ball_mm + at) / (ball_mm - at))
        right.append(-2 / math.pi * drop)
    inside = np.linalg.solve(system, np.stack([r[:-1] for r in right], axis=1))
    ends = [r[-1] + (kernel[-1, :-1] * weights) @ inside[:, i] for i, r in enumerate(right)]
    found = [np.append(inside[:, i], end) for i, end in enumerate(ends)]
    return found[0], found[-1], weights


@cache
def _gauss_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes and weights of [-1, 1]; a ball's curve asks for the same few counts at each of
    its contacts."""
    return np.polynomial.legendre.leggauss(count)


@cache
def _kernel_quadrature() -> tuple[np.ndarray, np.ndarray]:
    x, weights = _gauss_nodes(_KERNEL_NODES)
    return 0.5 * _KERNEL_END * (x + 1), 0.5 * _KERNEL_END * weights


def _compliance(x: np.ndarray, poisson_ratio: float) -> np.ndarray:
    """L(x), 1 of a half-space, written with exp(-2x) so that it does not overflow."""
    q = 3 - 4 * poisson_ratio
    e = np.exp(-2 * x)
    top = q * (1 - e**2) - 4 * x * e
    return top / (q * (1 + e**2) + (1 + q**2 + 4 * x**2) * e)
