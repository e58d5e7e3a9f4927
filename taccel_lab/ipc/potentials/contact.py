# SPDX-License-Identifier: Apache-2.0
"""Barrier potential of a collision set: energy, nodal gradient, Hessian, minimum distance.

The potential of one collision is k dhat bhat(d / dhat) with k = kappa * area [N], see
``barrier.contact_potential``; edge pairs carry the mollifier of [Li et al. 2020].
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.barrier import (
    contact_potential,
    contact_potential_d1,
    contact_potential_d2,
)
from taccel_lab.ipc.collisions import Collisions, closest_pair, collision_gap
from taccel_lab.ipc.distance.edge_edge_mollifier import (
    edge_edge_cross_sq,
    edge_edge_mollifier,
)
from taccel_lab.ipc.linear.scatter import NewtonSystem, add_block
from taccel_lab.ipc.mollified_edge_edge import (
    mollified_gradient,
    mollified_hessian,
    mollified_hessian_block,
)
from taccel_lab.ipc.pair_hessian import pair_gradient, pair_hessian, pair_hessian_block
from taccel_lab.ipc.reduce import sum_lists
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


@wp.func
def is_mollified(
    env: int, nodes: wp.vec4i, threshold: wp.float64, positions: wp.array2d(dtype=wp.vec3d)
) -> bool:
    """Whether an edge pair is parallel enough for the mollifier to act."""
    if threshold <= wp.float64(0.0):
        return False
    cross_sq = edge_edge_cross_sq(
        positions[env, nodes[0]],
        positions[env, nodes[1]],
        positions[env, nodes[2]],
        positions[env, nodes[3]],
    )
    return cross_sq < threshold


@wp.func
def stencil_size(kind: int) -> int:
    """Distinct nodes of a collision kind."""
    if kind == 1:
        return 3
    if kind == 2:
        return 2
    return 4


@wp.kernel
def _energy_kernel(
    active: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    kinds: wp.array2d(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    stiffnesses: wp.array2d(dtype=wp.float64),
    thresholds: wp.array2d(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    node_radii: wp.array(dtype=wp.float64),
    dhat: wp.float64,
    energies: wp.array2d(dtype=wp.float64),
):
    env, slot = wp.tid()
    if active[env] == 0 or slot >= counts[env]:
        return
    nodes = stencils[env, slot]
    pair = closest_pair(env, kinds[env, slot], nodes, positions)
    energy = contact_potential(collision_gap(pair, nodes, node_radii), dhat, stiffnesses[env, slot])
    threshold = thresholds[env, slot]
    if is_mollified(env, nodes, threshold, positions):
        cross_sq = edge_edge_cross_sq(
            positions[env, nodes[0]],
            positions[env, nodes[1]],
            positions[env, nodes[2]],
            positions[env, nodes[3]],
        )
        energy *= edge_edge_mollifier(cross_sq, threshold)
    energies[env, slot] = energy


@wp.kernel
def _gradient_kernel(
    active: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    kinds: wp.array2d(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    stiffnesses: wp.array2d(dtype=wp.float64),
    thresholds: wp.array2d(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    node_radii: wp.array(dtype=wp.float64),
    dhat: wp.float64,
    gradient: wp.array2d(dtype=wp.vec3d),
    min_distance: wp.array(dtype=wp.float64),
):
    env, slot = wp.tid()
    if active[env] == 0 or slot >= counts[env]:
        return
    kind = kinds[env, slot]
    nodes = stencils[env, slot]
    k = stiffnesses[env, slot]
    pair = closest_pair(env, kind, nodes, positions)
    d = collision_gap(pair, nodes, node_radii)
    wp.atomic_min(min_distance, env, d)
    rows = pair_gradient(pair, contact_potential_d1(d, dhat, k))
    if is_mollified(env, nodes, thresholds[env, slot], positions):
        rows = mollified_gradient(
            pair,
            positions[env, nodes[0]],
            positions[env, nodes[1]],
            positions[env, nodes[2]],
            positions[env, nodes[3]],
            thresholds[env, slot],
            contact_potential(d, dhat, k),
            contact_potential_d1(d, dhat, k),
        )
    for i in range(stencil_size(kind)):
        wp.atomic_add(gradient, env, nodes[i], wp.vec3d(rows[i, 0], rows[i, 1], rows[i, 2]))


@wp.kernel
def _hessian_kernel(
    active: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    kinds: wp.array2d(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    stiffnesses: wp.array2d(dtype=wp.float64),
    thresholds: wp.array2d(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    node_radii: wp.array(dtype=wp.float64),
    dhat: wp.float64,
    mode: int,
    system: NewtonSystem,
):
    env, slot = wp.tid()
    if active[env] == 0 or slot >= counts[env]:
        return
    kind = kinds[env, slot]
    nodes = stencils[env, slot]
    k = stiffnesses[env, slot]
    x0 = positions[env, nodes[0]]
    x1 = positions[env, nodes[1]]
    x2 = positions[env, nodes[2]]
    x3 = positions[env, nodes[3]]
    pair = closest_pair(env, kind, nodes, positions)
    d = collision_gap(pair, nodes, node_radii)
    e1 = contact_potential_d1(d, dhat, k)
    e2 = contact_potential_d2(d, dhat, k)
    size = stencil_size(kind)
    if is_mollified(env, nodes, thresholds[env, slot], positions):
        e0 = contact_potential(d, dhat, k)
        mollified = mollified_hessian(pair, x0, x1, x2, x3, thresholds[env, slot], e0, e1, e2, mode)
        for i in range(size):
            for j in range(size):
                add_block(env, nodes[i], nodes[j], mollified_hessian_block(mollified, i, j), system)
        return
    h = pair_hessian(pair, x0, x1, x2, x3, e1, e2, mode)
    for i in range(size):
        if system.free_index[nodes[i]] >= 0:
            for j in range(size):
                add_block(env, nodes[i], nodes[j], pair_hessian_block(h, i, j), system)


class ContactPotential:
    """Launches of the barrier energy over a collision set."""

    def __init__(self, model: Model, collisions: Collisions) -> None:
        self.model = model
        self.collisions = collisions
        self.energies = wp.zeros((model.env_count, 1), dtype=wp.float64, device=model.device)
        """Energy of each collision [J], shape [env_count, capacity]; valid up to ``counts``."""

    def _inputs(self, active: wp.array, positions: wp.array) -> list:
        c = self.collisions
        lists = [c.counts, c.kinds, c.stencils, c.stiffnesses, c.thresholds]
        return [active, *lists, positions, self.model.surface.node_radii, c.dhat]

    def energy(self, active: wp.array, positions: wp.array) -> np.ndarray:
        """Barrier energy of the current collision set [J], shape [env_count]."""
        c = self.collisions
        if self.energies.shape[1] < c.capacity:
            self.energies = wp.zeros(c.kinds.shape, dtype=wp.float64, device=self.model.device)
        if c.max_count:
            wp.launch(
                _energy_kernel,
                dim=(self.model.env_count, c.max_count),
                inputs=self._inputs(active, positions),
                outputs=[self.energies],
                device=self.model.device,
            )
        return sum_lists(self.energies, c.counts)

    def add_gradient(
        self, active: wp.array, positions: wp.array, gradient: wp.array, min_distance: wp.array
    ) -> None:
        """Add d energy / dx [N] of all nodes, soft and kinematic, and lower the minimum gap [m]."""
        c = self.collisions
        if c.max_count:
            wp.launch(
                _gradient_kernel,
                dim=(self.model.env_count, c.max_count),
                inputs=self._inputs(active, positions),
                outputs=[gradient, min_distance],
                device=self.model.device,
            )

    def add_hessian(
        self, active: wp.array, positions: wp.array, system: NewtonSystem, mode: int
    ) -> None:
        """Add the Hessian of the collisions to the Newton system."""
        c = self.collisions
        if c.max_count:
            wp.launch(
                _hessian_kernel,
                dim=(self.model.env_count, c.max_count),
                inputs=[*self._inputs(active, positions), mode, system],
                device=self.model.device,
            )
