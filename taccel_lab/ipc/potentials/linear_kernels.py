# SPDX-License-Identifier: Apache-2.0
"""Kernels of the elastic potential of linear tets, compiled for one material.

One Warp module per material, built when a scene first asks for it: the code of a material that no
scene uses is never compiled.
"""

from __future__ import annotations

from functools import cache

import warp as wp

from taccel_lab.ipc.elasticity.laws import Law
from taccel_lab.ipc.elasticity.principal import principal_block
from taccel_lab.ipc.potentials.element_data import ElementData, ElementKernels, modulus_index
from taccel_lab.ipc.potentials.staged_rows import (
    flush_blocks,
    flush_forces,
    put_block,
    put_force,
    stage_blocks,
    stage_forces,
)

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


@cache
def create_linear_kernels(law: Law) -> ElementKernels:
    """The kernels of a material, in a module of their own."""
    energy = law.energy
    piola = law.piola
    hessian = law.hessian
    module = wp.get_module(f"{__name__}.{law.model.value}")
    wp.set_module_options({"enable_backward": False}, module=module)

    @wp.kernel(module=module)
    def _linear_energy_kernel(
        active: wp.array(dtype=wp.int32),
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        energies: wp.array2d(dtype=wp.float64),
    ):
        env, tet = wp.tid()
        if active[env] == 0:
            return
        f = linear_deformation(env, tet, positions, d)
        psi = energy(f, d.moduli, modulus_index(env, tet, d))
        energies[env, tet] = d.volumes[env % d.volumes.shape[0], tet] * psi

    @wp.kernel(module=module)
    def _linear_gradient_kernel(
        active: wp.array(dtype=wp.int32),
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        local_gradients: wp.array3d(dtype=wp.vec3d),
    ):
        env, tet = wp.tid()
        item = env * d.volumes.shape[1] + tet
        stage = stage_forces()
        if active[env] != 0:
            rest = env % d.volumes.shape[0]
            f = linear_deformation(env, tet, positions, d)
            p = d.volumes[rest, tet] * piola(f, d.moduli, modulus_index(env, tet, d))
            for i in range(4):
                put_force(stage, local_gradients, item, i, p * d.gradients[rest, tet, i])
        flush_forces(stage, local_gradients, item, active[env] != 0)

    @wp.kernel(module=module)
    def _linear_hessian_kernel(
        active: wp.array(dtype=wp.int32),
        positions: wp.array2d(dtype=wp.vec3d),
        d: ElementData,
        psd_mode: int,
        blocks: wp.array3d(dtype=wp.mat33d),
    ):
        env, tet = wp.tid()
        item = env * d.volumes.shape[1] + tet
        stage = stage_blocks()
        if active[env] != 0:
            rest = env % d.volumes.shape[0]
            f = linear_deformation(env, tet, positions, d)
            volume = d.volumes[rest, tet]
            h = hessian(f, d.moduli, modulus_index(env, tet, d), psd_mode)
            to_principal = wp.transpose(h.v)
            beta_1 = to_principal * d.gradients[rest, tet, 1]
            beta_2 = to_principal * d.gradients[rest, tet, 2]
            beta_3 = to_principal * d.gradients[rest, tet, 3]
            h_11 = principal_block(h, volume * beta_1, beta_1)
            h_12 = principal_block(h, volume * beta_1, beta_2)
            h_13 = principal_block(h, volume * beta_1, beta_3)
            h_22 = principal_block(h, volume * beta_2, beta_2)
            h_23 = principal_block(h, volume * beta_2, beta_3)
            h_33 = principal_block(h, volume * beta_3, beta_3)
            # A rigid translation costs nothing: corner 0 has minus the sums of the others.
            h_10 = -(h_11 + h_12 + h_13)
            h_20 = -(wp.transpose(h_12) + h_22 + h_23)
            h_30 = -(wp.transpose(h_13 + h_23) + h_33)
            put_block(stage, blocks, item, 0, -(h_10 + h_20 + h_30))
            put_block(stage, blocks, item, 1, wp.transpose(h_10))
            put_block(stage, blocks, item, 2, wp.transpose(h_20))
            put_block(stage, blocks, item, 3, wp.transpose(h_30))
            put_block(stage, blocks, item, 4, h_11)
            put_block(stage, blocks, item, 5, h_12)
            put_block(stage, blocks, item, 6, h_13)
            put_block(stage, blocks, item, 7, h_22)
            put_block(stage, blocks, item, 8, h_23)
            put_block(stage, blocks, item, 9, h_33)
        flush_blocks(stage, blocks, item, active[env] != 0)

    return ElementKernels(_linear_energy_kernel, _linear_gradient_kernel, _linear_hessian_kernel)
