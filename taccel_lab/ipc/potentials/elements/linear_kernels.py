# SPDX-License-Identifier: Apache-2.0
"""Kernels of the elastic potential of linear tets, compiled for one material.

One Warp module per material, built when a scene first asks for it: the code of a material that no
scene uses is never compiled.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import warp as wp

from taccel_lab.ipc.elasticity.laws import Law
from taccel_lab.ipc.elasticity.principal import (
    PSD_NONE,
    PrincipalHessian,
    exact_block,
    principal_block,
)
from taccel_lab.ipc.potentials.elements.chunk_stage import (
    STAGED_THREADS,
    put_block,
    put_force,
    stage_blocks,
    stage_forces,
    sum_blocks,
    sum_forces,
)
from taccel_lab.ipc.potentials.elements.data import ElementData, ElementKernels, modulus_index
from taccel_lab.model.env_lists import Envs, env_at

wp.set_module_options({"enable_backward": False})


@wp.func
def linear_deformation(
    env: int, tet: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData
) -> wp.mat33d:
    """F = sum_i x_i b_i^T of a linear tet."""
    rest = env % d.volumes.shape[0]
    x0 = positions[env, d.nodes[tet, 0]]
    # Differences first: positions are large against an element.
    return (
        wp.outer(positions[env, d.nodes[tet, 1]] - x0, d.gradients[rest, tet, 1])
        + wp.outer(positions[env, d.nodes[tet, 2]] - x0, d.gradients[rest, tet, 2])
        + wp.outer(positions[env, d.nodes[tet, 3]] - x0, d.gradients[rest, tet, 3])
    )


@wp.struct
class CornerBlocks:
    """Blocks of the corners 1, 2 and 3 of a tet [N/m]; those of corner 0 follow."""

    h_11: wp.mat33d
    h_12: wp.mat33d
    h_13: wp.mat33d
    h_22: wp.mat33d
    h_23: wp.mat33d
    h_33: wp.mat33d


@wp.func
def _principal_blocks(
    env: int, tet: int, h: PrincipalHessian, volume: wp.float64, d: ElementData
) -> CornerBlocks:
    rest = env % d.volumes.shape[0]
    to_principal = wp.transpose(h.v)
    beta_1 = to_principal * d.gradients[rest, tet, 1]
    beta_2 = to_principal * d.gradients[rest, tet, 2]
    beta_3 = to_principal * d.gradients[rest, tet, 3]
    b = CornerBlocks()
    b.h_11 = principal_block(h, volume * beta_1, beta_1)
    b.h_12 = principal_block(h, volume * beta_1, beta_2)
    b.h_13 = principal_block(h, volume * beta_1, beta_3)
    b.h_22 = principal_block(h, volume * beta_2, beta_2)
    b.h_23 = principal_block(h, volume * beta_2, beta_3)
    b.h_33 = principal_block(h, volume * beta_3, beta_3)
    return b


@wp.func
def _exact_blocks(
    env: int, tet: int, f: wp.mat33d, curvatures: wp.vec3d, volume: wp.float64, d: ElementData
) -> CornerBlocks:
    rest = env % d.volumes.shape[0]
    a = volume * curvatures[0]
    c = volume * curvatures[1]
    e = volume * curvatures[2]
    inverse = wp.transpose(wp.inverse(f))
    b_1 = d.gradients[rest, tet, 1]
    b_2 = d.gradients[rest, tet, 2]
    b_3 = d.gradients[rest, tet, 3]
    g_1 = inverse * b_1
    g_2 = inverse * b_2
    g_3 = inverse * b_3
    b = CornerBlocks()
    b.h_11 = exact_block(c, e, a * wp.dot(b_1, b_1), g_1, g_1)
    b.h_12 = exact_block(c, e, a * wp.dot(b_1, b_2), g_1, g_2)
    b.h_13 = exact_block(c, e, a * wp.dot(b_1, b_3), g_1, g_3)
    b.h_22 = exact_block(c, e, a * wp.dot(b_2, b_2), g_2, g_2)
    b.h_23 = exact_block(c, e, a * wp.dot(b_2, b_3), g_2, g_3)
    b.h_33 = exact_block(c, e, a * wp.dot(b_3, b_3), g_3, g_3)
    return b


def _law_blocks(law: Law) -> Any:
    """``(env, tet, f, volume, i, psd_mode, d)``: CornerBlocks of a material."""
    hessian = law.hessian

    @wp.func
    def principal(
        env: int, tet: int, f: wp.mat33d, volume: wp.float64, i: int, mode: int, d: ElementData
    ) -> CornerBlocks:
        return _principal_blocks(env, tet, hessian(f, d.moduli, i, mode), volume, d)

    if law.curvatures is None:
        return principal
    curvatures = law.curvatures

    @wp.func
    def quickest(
        env: int, tet: int, f: wp.mat33d, volume: wp.float64, i: int, mode: int, d: ElementData
    ) -> CornerBlocks:
        if mode == PSD_NONE:
            found = curvatures(f, d.moduli.mu[i], d.moduli.lam[i], wp.float64(0.0))
            return _exact_blocks(env, tet, f, found, volume, d)
        return principal(env, tet, f, volume, i, mode, d)

    return quickest


@cache
def create_linear_kernels(law: Law) -> ElementKernels:
    """The kernels of a material, in a module of their own."""
    energy = law.energy
    piola = law.piola
    blocks_of = _law_blocks(law)
    module = wp.get_module(f"{__name__}.{law.model.value}")
    wp.set_module_options({"enable_backward": False, "block_dim": STAGED_THREADS}, module=module)

    @wp.kernel(module=module)
    def _linear_energy_kernel(
        active: Envs,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        energies: wp.array2d(dtype=wp.float64),
    ):
        place, tet = wp.tid()
        env = env_at(place, active)
        if env < 0:
            return
        f = linear_deformation(env, tet, positions, d)
        psi = energy(f, d.moduli, modulus_index(env, tet, d))
        energies[env, tet] = d.volumes[env % d.volumes.shape[0], tet] * psi

    @wp.kernel(module=module)
    def _linear_gradient_kernel(
        active: Envs,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        parts: wp.array2d(dtype=wp.vec3d),
    ):
        place, lane = wp.tid()
        env = env_at(place, active)
        if env < 0:
            return
        stage = stage_forces(lane, d.force_sums)
        tet = d.lanes[lane]
        if tet >= 0:
            rest = env % d.volumes.shape[0]
            f = linear_deformation(env, tet, positions, d)
            p = d.volumes[rest, tet] * piola(f, d.moduli, modulus_index(env, tet, d))
            for i in range(4):
                put_force(stage, lane, i, p * d.gradients[rest, tet, i])
        sum_forces(stage, env, lane, d.force_sums, parts)

    @wp.kernel(module=module)
    def _linear_hessian_kernel(
        active: Envs,
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        psd_modes: wp.array(dtype=wp.int32),
        parts: wp.array2d(dtype=wp.mat33d),
    ):
        place, lane = wp.tid()
        env = env_at(place, active)
        if env < 0:
            return
        stage = stage_blocks(lane, d.block_sums)
        tet = d.lanes[lane]
        if tet >= 0:
            rest = env % d.volumes.shape[0]
            f = linear_deformation(env, tet, positions, d)
            i = modulus_index(env, tet, d)
            h = blocks_of(env, tet, f, d.volumes[rest, tet], i, psd_modes[env], d)
            # A rigid translation costs nothing: corner 0 has minus the sums of the others.
            put_block(stage, lane, 0, -(h.h_11 + wp.transpose(h.h_12 + h.h_13)))
            put_block(stage, lane, 1, -(h.h_12 + h.h_22 + wp.transpose(h.h_23)))
            put_block(stage, lane, 2, -(h.h_13 + h.h_23 + h.h_33))
            put_block(stage, lane, 3, h.h_12)
            put_block(stage, lane, 4, h.h_13)
            put_block(stage, lane, 5, h.h_23)
        sum_blocks(stage, env, lane, d.block_sums, parts)

    return ElementKernels(_linear_energy_kernel, _linear_gradient_kernel, _linear_hessian_kernel)
