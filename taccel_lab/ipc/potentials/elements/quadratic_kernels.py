# SPDX-License-Identifier: Apache-2.0
"""Kernels of ten-node tets with straight edges at rest and one pressure each.

    E = sum_q V/4 psi_s(F_q) + V lambda u(mean_q e(F_q))

at four quadrature points: psi_s is the energy with lambda = 0, e the dilatation (``laws``).
Four points take the 24 strains of the element without spurious modes (30 - 6); with lambda at each
of them it would still lock mildly (Cook's membrane at nu = 0.499: 6 % instead of 0.7 %).

In materials that do not bear inversion a guard on the volume ratio is added (quadratic_shape.py).
Of its second derivatives a projected matrix takes g'' grad b grad b^T, which is positive.

Negative eigenvalues of the matrix are lifted at each point, for the shape energy plus the pressure
times the dilatation (of which only a bounded part counts, see quadratic_points.py); what the mean
adds is lambda V u'' g g^T, of a single eigenvalue.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from taccel_lab.ipc.elasticity.principal import PSD_NONE, lifted
from taccel_lab.ipc.elasticity.volume_bounds import (
    COEFFICIENTS,
    coefficient_corners,
    ratio_barrier,
)
from taccel_lab.ipc.potentials.elements.chunk_stage import STAGED_THREADS
from taccel_lab.ipc.potentials.elements.data import ElementData, ElementKernels, modulus_index
from taccel_lab.ipc.potentials.elements.point_stage import (
    POINT_LANES,
    keep,
    kept_common,
    kept_volume_part,
    opens_element,
    put_element,
    put_point,
    stage_points,
    write_blocks,
    written_elements,
)
from taccel_lab.ipc.potentials.elements.quadratic_shape import (
    GUARD_WEIGHT,
    OTHER,
    OWN_LESS_OTHER,
    common_deformation,
    corner_deformation,
    corner_gradients,
    guard_coefficient,
    guard_gradient,
    mat103d,
    point_deformation,
    row_of,
    shape_gradients,
)
from taccel_lab.model.env_lists import Envs, env_at

wp.set_module_options({"enable_backward": False})


@dataclass(frozen=True)
class PointLaw:
    """What happens at a quadrature point. ``start`` is what ``ElementData.starts`` has of it, zero
    unless viscous; ``d`` the ElementData, ``i`` the place of the element's moduli."""

    name: str
    start: Any
    """``(env, tet, q, d)``."""
    energy: Any
    """``(f, start, d, i)``: without the volumetric part [J/m^3]."""
    piola: Any
    dilatation: Any
    """``(f, start)``."""
    dilatation_slope: Any
    """``(f, start)``."""
    volumetric: Any
    """``(e)``: u, u', u''."""
    volumetric_modulus: Any
    """``(moduli, i)``: what u is multiplied by [Pa]."""
    scale: Any
    """``(env, tet, d)``: what the others leave out, 1 unless viscous."""
    hessian: Any
    """``(f, start, d, i, pressure, psd_mode)``: a PointHessian, with ``pressure`` times the
    dilatation."""
    guarded: Any
    """``(env, tet, positions, d)``: whether the element needs its guard."""


def create_quadratic_kernels(law: PointLaw) -> ElementKernels:
    """The kernels of a law at quadrature points, in a module of their own."""
    start_of = law.start
    energy = law.energy
    piola = law.piola
    dilatation = law.dilatation
    dilatation_slope = law.dilatation_slope
    volumetric = law.volumetric
    volumetric_modulus = law.volumetric_modulus
    scale = law.scale
    hessian = law.hessian
    guarded = law.guarded
    module = wp.get_module(f"{__name__}.{law.name}")
    wp.set_module_options({"enable_backward": False, "block_dim": STAGED_THREADS}, module=module)

    @wp.kernel(module=module)
    def _quadratic_energy_kernel(
        active: Envs,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        energies: wp.array2d(dtype=wp.float64),
    ):
        place, tet = wp.tid()
        env = env_at(place, active)
        if env < 0:
            return
        i = modulus_index(env, tet, d)
        quarter = wp.float64(0.25)
        shape = wp.float64(0.0)
        mean = wp.float64(0.0)
        common = common_deformation(env, tet, positions, d)
        q = int(0)
        while q < 4:
            f = point_deformation(env, tet, q, common, positions, d)
            start = start_of(env, tet, q, d)
            shape += quarter * energy(f, start, d, i)
            mean += quarter * dilatation(f, start)
            q += 1
        kept = wp.float64(0.0)
        if guarded(env, tet, positions, d):
            q = int(0)
            while q < COEFFICIENTS:
                kept += ratio_barrier(guard_coefficient(env, tet, q, positions, d))[0]
                q += 1
        bulk = volumetric_modulus(d.moduli, i) * volumetric(mean)[0]
        energies[env, tet] = (
            d.volumes[env % d.volumes.shape[0], tet]
            * scale(env, tet, d)
            * (shape + bulk + GUARD_WEIGHT * d.moduli.mu[i] * kept)
        )

    @wp.func
    def _mean_dilatation(
        env: int,
        tet: int,
        common: wp.mat33d,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
    ) -> wp.float64:
        mean = wp.float64(0.0)
        q = int(0)
        while q < 4:
            f = point_deformation(env, tet, q, common, positions, d)
            mean += wp.float64(0.25) * dilatation(f, start_of(env, tet, q, d))
            q += 1
        return mean

    @wp.func
    def _mean_slope(
        env: int,
        tet: int,
        common: wp.mat33d,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
    ) -> mat103d:
        """Slope of the mean dilatation in the nodes."""
        slope = mat103d()
        q = int(0)
        while q < 4:
            f = point_deformation(env, tet, q, common, positions, d)
            turn = dilatation_slope(f, start_of(env, tet, q, d))
            slope += wp.float64(0.25) * shape_gradients(env, tet, q, OTHER, OWN_LESS_OTHER, turn, d)
            q += 1
        return slope

    @wp.func
    def _factor(env: int, tet: int, d: ElementData) -> wp.float64:
        return d.volumes[env % d.volumes.shape[0], tet] * scale(env, tet, d)

    @wp.func
    def _add_guard_bends(
        env: int,
        tet: int,
        q: int,
        slope: wp.float64,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        blocks: wp.array3d(dtype=wp.mat33d),
    ):
        """Add the second derivatives of a coefficient times ``slope``."""
        c = coefficient_corners(q)
        sixth = slope / wp.float64(6.0)
        f_0 = sixth * corner_deformation(env, tet, c[0], positions, d)
        f_1 = sixth * corner_deformation(env, tet, c[1], positions, d)
        f_2 = sixth * corner_deformation(env, tet, c[2], positions, d)
        one = wp.identity(n=3, dtype=wp.float64)
        rows_0 = corner_gradients(env, tet, c[0], one, d)
        rows_1 = corner_gradients(env, tet, c[1], one, d)
        rows_2 = corner_gradients(env, tet, c[2], one, d)
        node_count = d.nodes.shape[1]
        pair = int(0)
        for a in range(node_count):
            a_0 = row_of(rows_0, a)
            a_1 = row_of(rows_1, a)
            a_2 = row_of(rows_2, a)
            for b in range(a, node_count):
                b_0 = row_of(rows_0, b)
                b_1 = row_of(rows_1, b)
                b_2 = row_of(rows_2, b)
                w = f_0 * (wp.cross(a_1, b_2) + wp.cross(a_2, b_1))
                w += f_1 * (wp.cross(a_0, b_2) + wp.cross(a_2, b_0))
                w += f_2 * (wp.cross(a_0, b_1) + wp.cross(a_1, b_0))
                blocks[env, tet, pair] = blocks[env, tet, pair] - wp.skew(w)
                pair += 1

    @wp.func
    def _add_guards(
        env: int,
        tet: int,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        psd_mode: int,
        blocks: wp.array3d(dtype=wp.mat33d),
    ):
        weight = _factor(env, tet, d) * GUARD_WEIGHT * d.moduli.mu[modulus_index(env, tet, d)]
        # Held in a variable so that Warp keeps the loops rolled.
        node_count = d.nodes.shape[1]
        q = int(0)
        while q < COEFFICIENTS:
            barrier = ratio_barrier(guard_coefficient(env, tet, q, positions, d))
            if barrier[1] != wp.float64(0.0):
                rows = guard_gradient(env, tet, q, positions, d)
                pair = int(0)
                for a in range(node_count):
                    g = (weight * barrier[2]) * row_of(rows, a)
                    for b in range(a, node_count):
                        blocks[env, tet, pair] = blocks[env, tet, pair] + wp.outer(
                            g, row_of(rows, b)
                        )
                        pair += 1
                if psd_mode == PSD_NONE:
                    _add_guard_bends(env, tet, q, weight * barrier[1], positions, d, blocks)
            q += 1

    @wp.kernel(module=module)
    def _quadratic_gradient_kernel(
        active: Envs,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        local_gradients: wp.array3d(dtype=wp.vec3d),
    ):
        place, tet = wp.tid()
        env = env_at(place, active)
        if env < 0:
            return
        rest = env % d.volumes.shape[0]
        i = modulus_index(env, tet, d)
        common = common_deformation(env, tet, positions, d)
        mean = _mean_dilatation(env, tet, common, positions, d)
        pressure = volumetric_modulus(d.moduli, i) * volumetric(mean)[1]
        factor = d.volumes[rest, tet] * scale(env, tet, d)
        # Stress integrals: l_c P over the element for each corner c, from l_c = OTHER + ...
        total = wp.mat33d()
        own_0 = wp.mat33d()
        own_1 = wp.mat33d()
        own_2 = wp.mat33d()
        own_3 = wp.mat33d()
        q = int(0)
        while q < 4:
            f = point_deformation(env, tet, q, common, positions, d)
            start = start_of(env, tet, q, d)
            p = piola(f, start, d, i) + pressure * dilatation_slope(f, start)
            total += p
            if q == 0:
                own_0 = p
            elif q == 1:
                own_1 = p
            elif q == 2:
                own_2 = p
            else:
                own_3 = p
            q += 1
        m_0 = factor * (OTHER * total + OWN_LESS_OTHER * own_0)
        m_1 = factor * (OTHER * total + OWN_LESS_OTHER * own_1)
        m_2 = factor * (OTHER * total + OWN_LESS_OTHER * own_2)
        m_3 = factor * (OTHER * total + OWN_LESS_OTHER * own_3)
        constant = wp.float64(0.25) * factor * total
        b_0 = d.gradients[rest, tet, 0]
        b_1 = d.gradients[rest, tet, 1]
        b_2 = d.gradients[rest, tet, 2]
        b_3 = d.gradients[rest, tet, 3]
        local_gradients[env, tet, 0] = (m_0 - constant) * b_0
        local_gradients[env, tet, 1] = (m_1 - constant) * b_1
        local_gradients[env, tet, 2] = (m_2 - constant) * b_2
        local_gradients[env, tet, 3] = (m_3 - constant) * b_3
        local_gradients[env, tet, 4] = m_1 * b_0 + m_0 * b_1
        local_gradients[env, tet, 5] = m_2 * b_1 + m_1 * b_2
        local_gradients[env, tet, 6] = m_2 * b_0 + m_0 * b_2
        local_gradients[env, tet, 7] = m_3 * b_0 + m_0 * b_3
        local_gradients[env, tet, 8] = m_3 * b_1 + m_1 * b_3
        local_gradients[env, tet, 9] = m_3 * b_2 + m_2 * b_3
        if not guarded(env, tet, positions, d):
            return
        q = int(0)
        while q < COEFFICIENTS:
            push = ratio_barrier(guard_coefficient(env, tet, q, positions, d))[1]
            if push != wp.float64(0.0):
                push *= factor * GUARD_WEIGHT * d.moduli.mu[i]
                rows = push * guard_gradient(env, tet, q, positions, d)
                for a in range(d.nodes.shape[1]):
                    local_gradients[env, tet, a] = local_gradients[env, tet, a] + row_of(rows, a)
            q += 1

    @wp.kernel(module=module)
    def _quadratic_hessian_kernel(
        active: Envs,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        psd_modes: wp.array(dtype=wp.int32),
        blocks: wp.array3d(dtype=wp.mat33d),
    ):
        place, lane = wp.tid()
        env = env_at(place, active)
        if env < 0:
            return
        stage = stage_points()
        psd_mode = psd_modes[env]
        count = d.nodes.shape[0]
        own = lane / POINT_LANES
        q = lane % POINT_LANES
        if own < count:
            i = modulus_index(env, own, d)
            common = wp.mat33d()
            volume_part = wp.vec3d()
            if opens_element(lane):
                common = common_deformation(env, own, positions, d)
                volume_part = volumetric(_mean_dilatation(env, own, common, positions, d))
                keep(stage, common, volume_part)
            else:
                common = kept_common(stage)
                volume_part = kept_volume_part(stage)
            modulus = volumetric_modulus(d.moduli, i)
            if q == 0:
                slope = _mean_slope(env, own, common, positions, d)
                factor = _factor(env, own, d)
                bulk = factor * modulus * lifted(volume_part[2], psd_mode)
                put_element(stage, lane, wp.float64(0.25) * factor, bulk, slope)
            f = point_deformation(env, own, q, common, positions, d)
            pressure = modulus * volume_part[1]
            h = hessian(f, start_of(env, own, q, d), d, i, pressure, psd_mode)
            turn = wp.transpose(h.frame)
            shapes = shape_gradients(env, own, q, OTHER, OWN_LESS_OTHER, turn, d)
            put_point(stage, lane, h, shapes)
        write_blocks(stage, env, lane, blocks)
        written = written_elements(lane, count)
        for tet in range(written[0], written[1]):
            if guarded(env, tet, positions, d):
                _add_guards(env, tet, positions, d, psd_mode, blocks)

    return ElementKernels(
        _quadratic_energy_kernel,
        _quadratic_gradient_kernel,
        _quadratic_hessian_kernel,
        POINT_LANES,
    )
