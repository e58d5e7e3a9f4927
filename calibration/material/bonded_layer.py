# SPDX-License-Identifier: Apache-2.0
"""Forces of a rigid ball or punch on a thin elastic layer that is bonded to a rigid base.

Small strains, no friction. The series is quick and holds for balls on layers that are thick or
moderately thin; the integral equation holds for any thickness, Poisson's ratio and punch, and is
the referee of the series. Both are linear in Young's modulus, so one division inverts them.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError

ToolKind = Literal["sphere", "cylinder", "flat"]

SERIES_MAX_CHI = 1.0
"""Largest sqrt(R depth) / thickness at which the series is used; beyond, its terms grow apart
(Dimitriadis et al. 2002 state the range)."""
_KERNEL_NODES = 240
_KERNEL_END = 24.0
"""Where 1 - L(x) has fallen below 1e-12."""


def sphere_force_series_n(
    depth_mm: np.ndarray,
    radius_mm: float,
    thickness_mm: float,
    poisson_ratio: float,
    young_modulus_pa: float = 1.0,
) -> np.ndarray:
    """Force of a ball on a bonded layer [N]: Hertz's formula with a series in chi.

    F = 4/3 E/(1-nu^2) sqrt(R d^3) (1 - 2 a0/pi chi + 4 a0^2/pi^2 chi^2
        - 8/pi^3 (a0^3 + 4 pi^2/15 b0) chi^3 + 16 a0/pi^4 (a0^3 + 3 pi^2/5 b0) chi^4),
    chi = sqrt(R d)/h, a0 = -(1.2876 - 1.4678 nu + 1.3442 nu^2)/(1-nu),
    b0 = (0.6387 - 1.0277 nu + 1.5164 nu^2)/(1-nu).

    E. K. Dimitriadis, F. Horkay, J. Maresca, B. Kachar, R. S. Chadwick: "Determination of elastic
    moduli of thin layers of soft material using the atomic force microscope", Biophysical Journal
    82 (2002), eq. 6 and 13. Valid for chi <= 1 and depths of up to a tenth of the layer; deeper,
    the force is too low by what the strains are no longer small.

    Args:
        depth_mm: Depth past first touch [mm], any shape, >= 0.
        radius_mm: Of the ball [mm].
        thickness_mm: Of the layer [mm].
        poisson_ratio: 0 to 0.5, both allowed.
        young_modulus_pa: Of the layer [Pa].
    """
    depth = _checked_depth(depth_mm)
    _check_layer(radius_mm, thickness_mm, poisson_ratio)
    nu = poisson_ratio
    a0 = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    b0 = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    chi = np.sqrt(radius_mm * depth) / thickness_mm
    series = (
        1
        - 2 * a0 / math.pi * chi
        + 4 * a0**2 / math.pi**2 * chi**2
        - 8 / math.pi**3 * (a0**3 + 4 * math.pi**2 / 15 * b0) * chi**3
        + 16 * a0 / math.pi**4 * (a0**3 + 3 * math.pi**2 / 5 * b0) * chi**4
    )
    hertz = 4 / 3 * young_modulus_pa / (1 - nu**2) * np.sqrt(radius_mm * depth**3) * 1e-6
    return hertz * series


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

    Arguments as of ``sphere_force_series_n``; for ``flat`` the radius is that of the disc of the
    layer's area.
    """
    depth = _checked_depth(depth_mm)
    _check_layer(radius_mm, thickness_mm, poisson_ratio)
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


def fast_young_modulus_pa(
    kind: ToolKind,
    depth_mm: np.ndarray,
    force_n: np.ndarray,
    radius_mm: float,
    thickness_mm: float,
    poisson_ratio: float,
) -> tuple[float, float]:
    """Young's modulus [Pa] of force-depth points and its relative spread over the points.

    The median over the points of measured force over the force of a layer of 1 Pa: in closed form
    for balls with chi <= 1, from the integral equation otherwise. Points at depth 0 are left out.
    The spread is the median absolute deviation times 1.4826, as a part of the modulus.
    """
    depth, force = np.asarray(depth_mm, dtype=float), np.asarray(force_n, dtype=float)
    usable = depth > 0
    if not usable.any():
        raise InputError("no point of the record lies below first touch (depth above 0 mm)")
    depth, force = depth[usable], force[usable]
    chi = math.sqrt(radius_mm * depth.max()) / thickness_mm
    if kind == "sphere" and chi <= SERIES_MAX_CHI:
        unit = sphere_force_series_n(depth, radius_mm, thickness_mm, poisson_ratio)
    else:
        unit = layer_force_n(kind, depth, radius_mm, thickness_mm, poisson_ratio)
    each = force / unit
    middle = float(np.median(each))
    spread = 1.4826 * float(np.median(np.abs(each - middle)))
    return middle, abs(spread / middle) if middle else math.inf


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
    nodes, weights = np.polynomial.legendre.leggauss(count)
    t = 0.5 * a_mm * (nodes + 1)
    weights = 0.5 * a_mm * weights
    at = np.append(t, a_mm)
    x, wx = np.polynomial.legendre.leggauss(_KERNEL_NODES)
    x, wx = 0.5 * _KERNEL_END * (x + 1), 0.5 * _KERNEL_END * wx
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


def _compliance(x: np.ndarray, poisson_ratio: float) -> np.ndarray:
    """L(x), 1 of a half-space, written with exp(-2x) so that it does not overflow."""
    q = 3 - 4 * poisson_ratio
    e = np.exp(-2 * x)
    top = q * (1 - e**2) - 4 * x * e
    return top / (q * (1 + e**2) + (1 + q**2 + 4 * x**2) * e)


def _checked_depth(depth_mm: np.ndarray) -> np.ndarray:
    depth = np.asarray(depth_mm, dtype=np.float64)
    if not np.isfinite(depth).all() or (depth < 0).any():
        raise InputError("depths must be finite and not negative [mm]")
    return depth


def _check_layer(radius_mm: float, thickness_mm: float, poisson_ratio: float) -> None:
    for name, value in (("radius", radius_mm), ("thickness", thickness_mm)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"the {name} must be above 0 mm, got {value:g}")
    if not 0 <= poisson_ratio <= 0.5:
        raise InputError(f"Poisson's ratio of a layer must lie in [0, 0.5], got {poisson_ratio:g}")
