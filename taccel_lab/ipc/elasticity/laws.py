# SPDX-License-Identifier: Apache-2.0
"""The materials by name, and the volumetric part of their energies.

The volumetric part of an energy, cut off so that an element can take it of its mean dilatation.

All materials here are affine in lambda: psi(F) = psi(F; mu, 0) + lambda u(e), with the dilatation
e = J - 1 (e = tr E, E the Green strain, for St. Venant-Kirchhoff) and a function u of a number. An
element that evaluates u at the mean of e over its volume has one pressure lambda u' and cannot lock
as lambda grows: it resists a change of its own volume, not of that around each quadrature point
[Nagtegaal, Parks and Rice 1974; Simo, Taylor and Pister 1985, the mean-dilatation method].

The materials by name, behind one signature that kernels are compiled against.

A kernel factory takes a ``Law`` and captures its functions, so a scene compiles the code of its
own materials and of no other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from taccel_lab.bodies.material import MaterialModel
from taccel_lab.ipc.elasticity import neo_hookean, st_venant_kirchhoff
from taccel_lab.ipc.elasticity.neo_hookean import log_excess
from taccel_lab.ipc.elasticity.principal import (
    PrincipalHessian,
    cofactor,
    displacement_invariants,
    displacement_trace,
)
from taccel_lab.ipc.elasticity.st_venant_kirchhoff import green_strain

wp.set_module_options({"enable_backward": False})


@wp.func
def volume_growth(f: wp.mat33d) -> wp.float64:
    """J - 1, without the cancellation of its two terms near rest."""
    invariants = displacement_invariants(f)
    return displacement_trace(f) + invariants[1] + invariants[2]


@wp.func
def volume_growth_slope(f: wp.mat33d) -> wp.mat33d:
    """d(J - 1)/dF."""
    return cofactor(f)


@wp.func
def strain_trace(f: wp.mat33d) -> wp.float64:
    """tr E."""
    return wp.trace(green_strain(f))


@wp.func
def strain_trace_slope(f: wp.mat33d) -> wp.mat33d:
    """d(tr E)/dF."""
    return f


@wp.func
def half_log_square(e: wp.float64) -> wp.vec3d:
    """u = ln(1 + e)^2 / 2 and its first two derivatives; u = +inf where e <= -1."""
    one = wp.float64(1.0)
    j = one + e
    if not (j > wp.float64(0.0)):
        return wp.vec3d(wp.float64(wp.inf), wp.float64(0.0), wp.float64(0.0))
    log_j = e - log_excess(e)
    return wp.vec3d(wp.float64(0.5) * log_j * log_j, log_j / j, (one - log_j) / (j * j))


@wp.func
def half_square(e: wp.float64) -> wp.vec3d:
    """u = e^2 / 2 and its first two derivatives."""
    return wp.vec3d(wp.float64(0.5) * e * e, e, wp.float64(1.0))


@wp.struct
class Moduli:
    """Material parameters of the elements, of all environments or of one after the other: see
    ``ElementArrays``."""

    mu: wp.array(dtype=wp.float64)
    """Shear modulus [Pa]."""
    lam: wp.array(dtype=wp.float64)
    """Lame's first parameter [Pa]."""
    ratio: wp.array(dtype=wp.float64)
    """c01 / (c10 + c01); empty unless the material is Mooney-Rivlin."""


@dataclass(frozen=True)
class Law:
    """Functions of a material. ``m`` are the Moduli, ``i`` the place of the element in them."""

    model: MaterialModel
    energy: Any
    """``energy(f, m, i)``: psi [J/m^3]."""
    piola: Any
    """``piola(f, m, i)``: d psi / dF [Pa]."""
    hessian: Any
    """``hessian(f, m, i, psd_mode)``: d^2 psi / dF^2, a PrincipalHessian [Pa]."""
    shape_energy: Any
    """Function like ``energy`` with lambda = 0: what is left without the volumetric part."""
    shape_piola: Any
    pressed_hessian: Any
    """``(f, m, i, pressure, psd_mode)``: of the shape energy plus pressure times dilatation."""
    dilatation: Any
    """``(f)``: e, the argument of the volumetric part."""
    dilatation_slope: Any
    """``(f)``: de/dF."""
    volumetric: Any
    """``(e)``: u and its first two derivatives; the energy is l u [J/m^3]."""
    volumetric_modulus: Any
    """``(m, i)``: l [Pa], lambda without what the shape energy keeps of it."""
    curvatures: Any = None
    """``(f, mu, lam, pressure)``: those of principal.py [Pa], of laws that it holds for."""


@dataclass(frozen=True)
class _Volumetric:
    """How the part of an energy that is linear in lambda is taken."""

    dilatation: Any
    slope: Any
    function: Any


_LOGARITHM = _Volumetric(volume_growth, volume_growth_slope, half_log_square)
_SQUARE = _Volumetric(volume_growth, volume_growth_slope, half_square)
_STRAIN = _Volumetric(strain_trace, strain_trace_slope, half_square)


def _of_lame(
    model: MaterialModel,
    energy: Any,
    piola: Any,
    pressed: Any,
    volumetric: _Volumetric,
    hessian: Any = None,
    curvatures: Any = None,
) -> Law:
    """Law of functions (f, mu, lam); ``hessian``, if there is a quicker one without pressure."""

    @wp.func
    def law_energy(f: wp.mat33d, m: Moduli, i: int) -> wp.float64:
        return energy(f, m.mu[i], m.lam[i])

    @wp.func
    def law_piola(f: wp.mat33d, m: Moduli, i: int) -> wp.mat33d:
        return piola(f, m.mu[i], m.lam[i])

    @wp.func
    def pressed_law_hessian(f: wp.mat33d, m: Moduli, i: int, mode: int) -> PrincipalHessian:
        return pressed(f, m.mu[i], m.lam[i], wp.float64(0.0), mode)

    @wp.func
    def quick_law_hessian(f: wp.mat33d, m: Moduli, i: int, mode: int) -> PrincipalHessian:
        return hessian(f, m.mu[i], m.lam[i], mode)

    @wp.func
    def volumetric_modulus(m: Moduli, i: int) -> wp.float64:
        return m.lam[i]

    @wp.func
    def shape_energy(f: wp.mat33d, m: Moduli, i: int) -> wp.float64:
        return energy(f, m.mu[i], wp.float64(0.0))

    @wp.func
    def shape_piola(f: wp.mat33d, m: Moduli, i: int) -> wp.mat33d:
        return piola(f, m.mu[i], wp.float64(0.0))

    @wp.func
    def shape_hessian(
        f: wp.mat33d, m: Moduli, i: int, pressure: wp.float64, mode: int
    ) -> PrincipalHessian:
        return pressed(f, m.mu[i], wp.float64(0.0), pressure, mode)

    return Law(
        model,
        law_energy,
        law_piola,
        pressed_law_hessian if hessian is None else quick_law_hessian,
        shape_energy,
        shape_piola,
        shape_hessian,
        volumetric.dilatation,
        volumetric.slope,
        volumetric.function,
        volumetric_modulus,
        curvatures,
    )


def _of_lame_and_ratio(
    model: MaterialModel, energy: Any, piola: Any, pressed: Any, volumetric: _Volumetric
) -> Law:
    """Law of functions (f, mu, lam, ratio).

    The shape part keeps the part 2 ratio mu of lambda: with none at all the coefficient of
    (ln J)^2 is negative, and a quadrature point could collapse.
    """

    @wp.func
    def law_energy(f: wp.mat33d, m: Moduli, i: int) -> wp.float64:
        return energy(f, m.mu[i], m.lam[i], m.ratio[i])

    @wp.func
    def law_piola(f: wp.mat33d, m: Moduli, i: int) -> wp.mat33d:
        return piola(f, m.mu[i], m.lam[i], m.ratio[i])

    @wp.func
    def law_hessian(f: wp.mat33d, m: Moduli, i: int, mode: int) -> PrincipalHessian:
        return pressed(f, m.mu[i], m.lam[i], m.ratio[i], wp.float64(0.0), mode)

    @wp.func
    def volumetric_modulus(m: Moduli, i: int) -> wp.float64:
        return m.lam[i] - wp.float64(2.0) * m.ratio[i] * m.mu[i]

    @wp.func
    def shape_energy(f: wp.mat33d, m: Moduli, i: int) -> wp.float64:
        return energy(f, m.mu[i], wp.float64(2.0) * m.ratio[i] * m.mu[i], m.ratio[i])

    @wp.func
    def shape_piola(f: wp.mat33d, m: Moduli, i: int) -> wp.mat33d:
        return piola(f, m.mu[i], wp.float64(2.0) * m.ratio[i] * m.mu[i], m.ratio[i])

    @wp.func
    def shape_hessian(
        f: wp.mat33d, m: Moduli, i: int, pressure: wp.float64, mode: int
    ) -> PrincipalHessian:
        return pressed(
            f, m.mu[i], wp.float64(2.0) * m.ratio[i] * m.mu[i], m.ratio[i], pressure, mode
        )

    return Law(
        model,
        law_energy,
        law_piola,
        law_hessian,
        shape_energy,
        shape_piola,
        shape_hessian,
        volumetric.dilatation,
        volumetric.slope,
        volumetric.function,
        volumetric_modulus,
    )


LAWS = {
    law.model: law
    for law in (
        _of_lame(
            MaterialModel.NEO_HOOKEAN,
            neo_hookean.neo_hookean_energy,
            neo_hookean.neo_hookean_piola,
            neo_hookean.neo_hookean_pressed_hessian,
            _LOGARITHM,
            hessian=neo_hookean.neo_hookean_hessian,
            curvatures=neo_hookean.neo_hookean_curvatures,
        ),
        _of_lame(
            MaterialModel.STABLE_NEO_HOOKEAN,
            neo_hookean.stable_neo_hookean_energy,
            neo_hookean.stable_neo_hookean_piola,
            neo_hookean.stable_neo_hookean_hessian,
            _SQUARE,
        ),
        _of_lame(
            MaterialModel.ST_VENANT_KIRCHHOFF,
            st_venant_kirchhoff.st_venant_kirchhoff_energy,
            st_venant_kirchhoff.st_venant_kirchhoff_piola,
            st_venant_kirchhoff.st_venant_kirchhoff_hessian,
            _STRAIN,
        ),
        _of_lame_and_ratio(
            MaterialModel.MOONEY_RIVLIN,
            neo_hookean.mooney_rivlin_energy,
            neo_hookean.mooney_rivlin_piola,
            neo_hookean.mooney_rivlin_hessian,
            _LOGARITHM,
        ),
    )
}
