# SPDX-License-Identifier: Apache-2.0
"""Elastic potential of linear tets: energy, nodal gradient and Hessian blocks per environment.

One thread per (environment, tet) evaluates an element; nodes and matrix blocks then gather from
their elements in a fixed order, so that no result depends on the order of execution.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.elasticity.neo_hookean import (
    diagonal_block,
    neo_hookean_block,
    neo_hookean_energy,
    neo_hookean_piola,
)
from taccel_lab.ipc.reduce import sum_rows
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})

PSD_NONE = 0
"""The exact Hessian."""
PSD_CLAMP = 1
"""Negative element eigenvalues become zero [Teran et al. 2005]."""
PSD_ABS = 2
"""Negative element eigenvalues change sign [Chen et al. 2024]: fewer iterations as nu -> 0.5."""


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


@wp.func
def lift(value: wp.float64, mode: int) -> wp.float64:
    """How much to add to a negative eigenvalue so that it is clamped or mirrored."""
    if value >= wp.float64(0.0) or mode == 0:
        return wp.float64(0.0)
    if mode == 2:
        return wp.float64(-2.0) * value
    return -value


@wp.func
def add_mode(
    env: int,
    tet: int,
    rest: int,
    weight: wp.float64,
    q: wp.mat33d,
    shape_gradients: wp.array3d(dtype=wp.vec3d),
    blocks: wp.array3d(dtype=wp.mat33d),
):
    """Add weight (Q b_i)(Q b_j)^T to the element blocks, i <= j."""
    slot = int(0)
    for i in range(4):
        qi = weight * (q * shape_gradients[rest, tet, i])
        for j in range(i, 4):
            blocks[env, tet, slot] += wp.outer(qi, q * shape_gradients[rest, tet, j])
            slot += 1


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
    m = volume * mu[tet]
    l = volume * lam[tet]
    f_inv_t = wp.transpose(wp.inverse(f))
    log_j = wp.log(wp.determinant(f))
    slot = int(0)
    for i in range(4):
        b_i = shape_gradients[rest, tet, i]
        g_i = f_inv_t * b_i
        for j in range(i, 4):
            b_j = shape_gradients[rest, tet, j]
            blocks[env, tet, slot] = neo_hookean_block(b_i, b_j, g_i, f_inv_t * b_j, m, l, log_j)
            slot += 1
    if psd_mode == 0:
        return

    # Spectral modes: F = U S V^T from the eigenvectors of F^T F.
    v = wp.mat33d()
    squares = wp.vec3d()
    wp.eig3(wp.transpose(f) * f, v, squares)
    s = wp.vec3d(wp.sqrt(squares[0]), wp.sqrt(squares[1]), wp.sqrt(squares[2]))
    fv = f * v
    u = fv * wp.diag(
        wp.vec3d(wp.float64(1.0) / s[0], wp.float64(1.0) / s[1], wp.float64(1.0) / s[2])
    )
    c = m - l * log_j
    half = wp.float64(0.7071067811865476)
    for k in range(3):
        a = k
        b = (k + 1) % 3
        u_a = wp.vec3d(u[0, a], u[1, a], u[2, a])
        u_b = wp.vec3d(u[0, b], u[1, b], u[2, b])
        v_a = wp.vec3d(v[0, a], v[1, a], v[2, a])
        v_b = wp.vec3d(v[0, b], v[1, b], v[2, b])
        ratio = c / (s[a] * s[b])
        twist = lift(m - ratio, psd_mode)
        if twist > wp.float64(0.0):
            q = half * (wp.outer(u_a, v_b) - wp.outer(u_b, v_a))
            add_mode(env, tet, rest, twist, q, shape_gradients, blocks)
        flip = lift(m + ratio, psd_mode)
        if flip > wp.float64(0.0):
            q = half * (wp.outer(u_a, v_b) + wp.outer(u_b, v_a))
            add_mode(env, tet, rest, flip, q, shape_gradients, blocks)
    w = wp.mat33d()
    values = wp.vec3d()
    wp.eig3(diagonal_block(s, m, l, c), w, values)
    for k in range(3):
        stretch = lift(values[k], psd_mode)
        if stretch > wp.float64(0.0):
            q = u * wp.diag(wp.vec3d(w[0, k], w[1, k], w[2, k])) * wp.transpose(v)
            add_mode(env, tet, rest, stretch, q, shape_gradients, blocks)


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
