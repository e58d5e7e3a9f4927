# SPDX-License-Identifier: Apache-2.0
"""Elastic laws at the quadrature points of ten-node tets."""

from __future__ import annotations

from functools import cache

import warp as wp

from taccel_lab.bodies.material import MaterialModel
from taccel_lab.ipc.elasticity.laws import LAWS, volume_growth
from taccel_lab.ipc.elasticity.principal import PSD_NONE
from taccel_lab.ipc.potentials.elements.data import ElementData, ElementKernels
from taccel_lab.ipc.potentials.elements.point_stage import (
    PointHessian,
    exact_point_hessian,
    point_hessian,
)
from taccel_lab.ipc.potentials.elements.quadratic_kernels import (
    PointLaw,
    create_quadratic_kernels,
)
from taccel_lab.ipc.potentials.elements.quadratic_shape import needs_guard, needs_none

wp.set_module_options({"enable_backward": False})

BEARS_INVERSION = (MaterialModel.STABLE_NEO_HOOKEAN, MaterialModel.ST_VENANT_KIRCHHOFF)
"""Laws whose energy stays finite there."""


@wp.func
def _no_start(env: int, tet: int, q: int, d: ElementData) -> wp.mat33d:
    return wp.mat33d()


@wp.func
def _one(env: int, tet: int, d: ElementData) -> wp.float64:
    return wp.float64(1.0)


@wp.func
def _pressure_of_matrix(pressure: wp.float64, mu: wp.float64, mode: int) -> wp.float64:
    """The pressure whose part of the exact matrix goes into a projected one.

    The integral of an even pressure times J depends on the boundary alone: what it adds to one
    element its neighbours take away again. Lifting eigenvalues of each for itself leaves the sum
    far too stiff once the pressure exceeds the shear modulus, and Newton's steps far too short; a
    pressure below zero (compression) makes every rotation's eigenvalue negative. Leaving such parts
    out is exact where the pressure is even, and always positive.
    """
    if mode == PSD_NONE:
        return pressure
    return wp.clamp(pressure, wp.float64(0.0), mu)


@wp.func
def _whole_pressure(pressure: wp.float64, mu: wp.float64, mode: int) -> wp.float64:
    """Pressure as it is, for the trace of the strain, whose integral does depend on the inside."""
    return pressure


@cache
def elastic_point_law(model: MaterialModel) -> PointLaw:
    """What an elastic law makes at a point of the deformation there."""
    law = LAWS[model]
    shape_energy = law.shape_energy
    shape_piola = law.shape_piola
    pressed = law.pressed_hessian
    law_dilatation = law.dilatation
    law_slope = law.dilatation_slope
    even = law.dilatation is volume_growth
    pressure_of_matrix = _pressure_of_matrix if even else _whole_pressure

    @wp.func
    def energy(f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int) -> wp.float64:
        return shape_energy(f, d.moduli, i)

    @wp.func
    def piola(f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int) -> wp.mat33d:
        return shape_piola(f, d.moduli, i)

    @wp.func
    def dilatation(f: wp.mat33d, start: wp.mat33d) -> wp.float64:
        return law_dilatation(f)

    @wp.func
    def dilatation_slope(f: wp.mat33d, start: wp.mat33d) -> wp.mat33d:
        return law_slope(f)

    @wp.func
    def principal(
        f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int, pressure: wp.float64, mode: int
    ) -> PointHessian:
        bounded = pressure_of_matrix(pressure, d.moduli.mu[i], mode)
        return point_hessian(pressed(f, d.moduli, i, bounded, mode))

    hessian = principal
    if law.curvatures is not None:
        curvatures = law.curvatures

        @wp.func
        def quickest(
            f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int, pressure: wp.float64, mode: int
        ) -> PointHessian:
            if mode == PSD_NONE:
                found = curvatures(f, d.moduli.mu[i], wp.float64(0.0), pressure)
                return exact_point_hessian(f, found)
            return principal(f, start, d, i, pressure, mode)

        hessian = quickest

    return PointLaw(
        name=model.value,
        start=_no_start,
        energy=energy,
        piola=piola,
        dilatation=dilatation,
        dilatation_slope=dilatation_slope,
        volumetric=law.volumetric,
        volumetric_modulus=law.volumetric_modulus,
        scale=_one,
        hessian=hessian,
        guarded=needs_none if model in BEARS_INVERSION else needs_guard,
    )


@cache
def elastic_quadratic_kernels(model: MaterialModel) -> ElementKernels:
    """The kernels of an elastic law."""
    return create_quadratic_kernels(elastic_point_law(model))
