# SPDX-License-Identifier: Apache-2.0
"""Elastic potential of linear tets: energy, nodal gradient and Hessian blocks per environment.

One thread per (environment, tet) evaluates an element; nodes and matrix blocks then gather from
their elements in a fixed order, so that no result depends on the order of execution.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.elasticity.neo_hookean import (
    PSD_ABS,
    PSD_CLAMP,
    PSD_NONE,
    neo_hookean_energy,
    neo_hookean_hessian,
    neo_hookean_piola,
    principal_block,
)
from taccel_lab.ipc.reduce import sum_rows
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})

__all__ = ["PSD_ABS", "PSD_CLAMP", "PSD_NONE", "ElasticPotential"]


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


@wp.kernel
def _tet_energy_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    tets: wp.array(dtype=wp.vec4i),
    shape_gradients: wp.array3d(dtype=wp.vec3d),
    volumes: wp.array2d(dtype=wp.float64),
    mu: wp.array(dtype=wp.float64),
    lam: wp.array(dtype=wp.float64),
    energies: wp.array2d(dtype=wp.float64),
):
    env, tet = wp.tid()
    if active[env] == 0:
        return
    rest = env % volumes.shape[0]
    f = deformation_gradient(env, rest, tet, tets[tet], positions, shape_gradients)
    energies[env, tet] = volumes[rest, tet] * neo_hookean_energy(f, mu[tet], lam[tet])


@wp.kernel
def _tet_gradient_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    tets: wp.array(dtype=wp.vec4i),
    shape_gradients: wp.array3d(dtype=wp.vec3d),
    volumes: wp.array2d(dtype=wp.float64),
    mu: wp.array(dtype=wp.float64),
    lam: wp.array(dtype=wp.float64),
    corner_gradients: wp.array3d(dtype=wp.vec3d),
):
    env, tet = wp.tid()
    if active[env] == 0:
        return
    rest = env % volumes.shape[0]
    f = deformation_gradient(env, rest, tet, tets[tet], positions, shape_gradients)
    p = volumes[rest, tet] * neo_hookean_piola(f, mu[tet], lam[tet])
    for i in range(4):
        corner_gradients[env, tet, i] = p * shape_gradients[rest, tet, i]


@wp.kernel
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


@wp.kernel
def _tet_hessian_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    tets: wp.array(dtype=wp.vec4i),
    shape_gradients: wp.array3d(dtype=wp.vec3d),
    volumes: wp.array2d(dtype=wp.float64),
    mu: wp.array(dtype=wp.float64),
    lam: wp.array(dtype=wp.float64),
    psd_mode: int,
    blocks: wp.array3d(dtype=wp.mat33d),
):
    env, tet = wp.tid()
    if active[env] == 0:
        return
    rest = env % volumes.shape[0]
    f = deformation_gradient(env, rest, tet, tets[tet], positions, shape_gradients)
    volume = volumes[rest, tet]
    h = neo_hookean_hessian(f, mu[tet], lam[tet], psd_mode)
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
    # A rigid translation costs nothing: the blocks of corner 0 are minus the sums of the others.
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


@wp.kernel
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
    total = wp.mat33d()
    for k in range(source_starts[block], source_starts[block + 1]):
        code = sources[k]
        element = element_blocks[env, code // 20, (code % 20) // 2]
        if code % 2 == 1:
            total += wp.transpose(element)
        else:
            total += element
    values[env, block] = total


class ElasticPotential:
    """Workspace and launches of the elastic energy of a model."""

    def __init__(self, model: Model) -> None:
        self.model = model
        env_count, tet_count = model.env_count, model.elastic.tets.shape[0]
        self.energies = wp.zeros((env_count, tet_count), dtype=wp.float64, device=model.device)
        """Energy of each tet [J], shape [env_count, tet_count]."""
        self._corner_gradients = wp.zeros(
            (env_count, tet_count, 4), dtype=wp.vec3d, device=model.device
        )
        self._blocks = wp.zeros((env_count, tet_count, 10), dtype=wp.mat33d, device=model.device)

    def _inputs(self, active: wp.array, positions: wp.array) -> list:
        e = self.model.elastic
        return [active, positions, e.tets, e.shape_gradients, e.volumes, e.mu, e.lam]

    def energy(self, active: wp.array, positions: wp.array) -> np.ndarray:
        """Energy [J], shape [env_count]; +inf when a tet is inverted; stale where not active."""
        wp.launch(
            _tet_energy_kernel,
            dim=self.energies.shape,
            inputs=self._inputs(active, positions),
            outputs=[self.energies],
            device=self.model.device,
        )
        return sum_rows(self.energies)

    def add_gradient(self, active: wp.array, positions: wp.array, gradient: wp.array) -> None:
        """Add d energy / dx [N] to ``gradient``, shape [env_count, node_count]."""
        e, device = self.model.elastic, self.model.device
        wp.launch(
            _tet_gradient_kernel,
            dim=self.energies.shape,
            inputs=self._inputs(active, positions),
            outputs=[self._corner_gradients],
            device=device,
        )
        wp.launch(
            _gather_gradient_kernel,
            dim=(self.model.env_count, self.model.soft_count),
            inputs=[active, e.node_tet_starts, e.node_tets, self._corner_gradients],
            outputs=[gradient],
            device=device,
        )

    def set_hessian(
        self, active: wp.array, positions: wp.array, values: wp.array, psd_mode: int
    ) -> None:
        """Overwrite the matrix blocks ``values`` [N/m], shape [env_count, block_count]."""
        device = self.model.device
        wp.launch(
            _tet_hessian_kernel,
            dim=self.energies.shape,
            inputs=[*self._inputs(active, positions), psd_mode],
            outputs=[self._blocks],
            device=device,
        )
        wp.launch(
            _gather_blocks_kernel,
            dim=values.shape,
            inputs=[active, self.model.source_starts, self.model.sources, self._blocks],
            outputs=[values],
            device=device,
        )
