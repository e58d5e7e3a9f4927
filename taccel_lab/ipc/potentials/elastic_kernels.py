# SPDX-License-Identifier: Apache-2.0
"""Kernels of the elastic potential of linear tets, compiled for one material.

One Warp module per material, built when a scene first asks for it: the code of a material that no
scene uses is never compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import warp as wp

from taccel_lab.ipc.elasticity.laws import LAWS, Moduli
from taccel_lab.ipc.elasticity.principal import principal_block
from taccel_lab.scene.material import MaterialModel

wp.set_module_options({"enable_backward": False})


@dataclass(frozen=True)
class ElasticKernels:
    """Launched over (environment, tet), the last two over (environment, node or block)."""

    energy: wp.Kernel
    gradient: wp.Kernel
    hessian: wp.Kernel
    gather_gradient: wp.Kernel
    gather_blocks: wp.Kernel


@wp.func
def deformation_gradient(
    env: int,
    rest: int,
    tet: int,
    nodes: wp.vec4i,
    positions: wp.array2d(dtype=wp.vec3d),
    shape_gradients: wp.array3d(dtype=wp.vec3d),
) -> wp.mat33d:
    """F = sum_i x_i b_i^T of a linear tet."""
    x0 = positions[env, nodes[0]]
    # Differences first: positions are large against an element.
    return (
        wp.outer(positions[env, nodes[1]] - x0, shape_gradients[rest, tet, 1])
        + wp.outer(positions[env, nodes[2]] - x0, shape_gradients[rest, tet, 2])
        + wp.outer(positions[env, nodes[3]] - x0, shape_gradients[rest, tet, 3])
    )


@wp.func
def gathered_block(
    env: int,
    block: int,
    source_starts: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.int32),
    element_blocks: wp.array3d(dtype=wp.mat33d),
    start: wp.mat33d,
) -> wp.mat33d:
    """``start`` plus the element blocks of one entry of the pattern, in a fixed order."""
    total = wp.mat33d(start)
    for k in range(source_starts[block], source_starts[block + 1]):
        code = sources[k]
        element = element_blocks[env, code // 20, (code % 20) // 2]
        if code % 2 == 1:
            total += wp.transpose(element)
        else:
            total += element
    return total


@cache
def create_elastic_kernels(model: MaterialModel) -> ElasticKernels:
    """The kernels of a material, in a module of their own."""
    law = LAWS[model]
    energy = law.energy
    piola = law.piola
    hessian = law.hessian
    module = wp.get_module(f"{__name__}.{model.value}")
    wp.set_module_options({"enable_backward": False}, module=module)

    @wp.kernel(module=module)
    def _tet_energy_kernel(
        active: wp.array(dtype=wp.int32),
        positions: wp.array2d(dtype=wp.vec3d),
        tets: wp.array(dtype=wp.vec4i),
        shape_gradients: wp.array3d(dtype=wp.vec3d),
        volumes: wp.array2d(dtype=wp.float64),
        moduli: Moduli,
        energies: wp.array2d(dtype=wp.float64),
    ):
        env, tet = wp.tid()
        if active[env] == 0:
            return
        rest = env % volumes.shape[0]
        f = deformation_gradient(env, rest, tet, tets[tet], positions, shape_gradients)
        energies[env, tet] = volumes[rest, tet] * energy(f, moduli, tet)

    @wp.kernel(module=module)
    def _tet_gradient_kernel(
        active: wp.array(dtype=wp.int32),
        positions: wp.array2d(dtype=wp.vec3d),
        tets: wp.array(dtype=wp.vec4i),
        shape_gradients: wp.array3d(dtype=wp.vec3d),
        volumes: wp.array2d(dtype=wp.float64),
        moduli: Moduli,
        corner_gradients: wp.array3d(dtype=wp.vec3d),
    ):
        env, tet = wp.tid()
        if active[env] == 0:
            return
        rest = env % volumes.shape[0]
        f = deformation_gradient(env, rest, tet, tets[tet], positions, shape_gradients)
        p = volumes[rest, tet] * piola(f, moduli, tet)
        for i in range(4):
            corner_gradients[env, tet, i] = p * shape_gradients[rest, tet, i]

    @wp.kernel(module=module)
    def _tet_hessian_kernel(
        active: wp.array(dtype=wp.int32),
        positions: wp.array2d(dtype=wp.vec3d),
        tets: wp.array(dtype=wp.vec4i),
        shape_gradients: wp.array3d(dtype=wp.vec3d),
        volumes: wp.array2d(dtype=wp.float64),
        moduli: Moduli,
        psd_mode: int,
        blocks: wp.array3d(dtype=wp.mat33d),
    ):
        env, tet = wp.tid()
        if active[env] == 0:
            return
        rest = env % volumes.shape[0]
        f = deformation_gradient(env, rest, tet, tets[tet], positions, shape_gradients)
        volume = volumes[rest, tet]
        h = hessian(f, moduli, tet, psd_mode)
        to_principal = wp.transpose(h.v)
        beta_1 = to_principal * shape_gradients[rest, tet, 1]
        beta_2 = to_principal * shape_gradients[rest, tet, 2]
        beta_3 = to_principal * shape_gradients[rest, tet, 3]
        h_11 = principal_block(h, volume * beta_1, beta_1)
        h_12 = principal_block(h, volume * beta_1, beta_2)
        h_13 = principal_block(h, volume * beta_1, beta_3)
        h_22 = principal_block(h, volume * beta_2, beta_2)
        h_23 = principal_block(h, volume * beta_2, beta_3)
        h_33 = principal_block(h, volume * beta_3, beta_3)
        # A rigid translation costs nothing: the blocks of corner 0 are minus the sums of others.
        h_10 = -(h_11 + h_12 + h_13)
        h_20 = -(wp.transpose(h_12) + h_22 + h_23)
        h_30 = -(wp.transpose(h_13 + h_23) + h_33)
        blocks[env, tet, 0] = -(h_10 + h_20 + h_30)
        blocks[env, tet, 1] = wp.transpose(h_10)
        blocks[env, tet, 2] = wp.transpose(h_20)
        blocks[env, tet, 3] = wp.transpose(h_30)
        blocks[env, tet, 4] = h_11
        blocks[env, tet, 5] = h_12
        blocks[env, tet, 6] = h_13
        blocks[env, tet, 7] = h_22
        blocks[env, tet, 8] = h_23
        blocks[env, tet, 9] = h_33

    # The same for all materials, but a second module would cost another second to compile.
    @wp.kernel(module=module)
    def _gather_gradient_kernel(
        active: wp.array(dtype=wp.int32),
        node_tet_starts: wp.array(dtype=wp.int32),
        node_tets: wp.array(dtype=wp.int32),
        corner_gradients: wp.array3d(dtype=wp.vec3d),
        gradient: wp.array2d(dtype=wp.vec3d),
    ):
        env, node = wp.tid()
        if active[env] == 0:
            return
        total = gradient[env, node]
        for k in range(node_tet_starts[node], node_tet_starts[node + 1]):
            code = node_tets[k]
            total += corner_gradients[env, code // 4, code % 4]
        gradient[env, node] = total

    @wp.kernel(module=module)
    def _gather_blocks_kernel(
        active: wp.array(dtype=wp.int32),
        source_starts: wp.array(dtype=wp.int32),
        sources: wp.array(dtype=wp.int32),
        element_blocks: wp.array3d(dtype=wp.mat33d),
        values: wp.array2d(dtype=wp.mat33d),
    ):
        env, block = wp.tid()
        if active[env] == 0:
            return
        values[env, block] = gathered_block(
            env, block, source_starts, sources, element_blocks, wp.mat33d()
        )

    return ElasticKernels(
        _tet_energy_kernel,
        _tet_gradient_kernel,
        _tet_hessian_kernel,
        _gather_gradient_kernel,
        _gather_blocks_kernel,
    )
