# SPDX-License-Identifier: Apache-2.0
"""Barrier potential of a collision set: energy, nodal gradient, Hessian, minimum distance.

The potential of one collision is k r g(gap / r) with k = kappa * area [N] and its range r, dhat or
that of the guard (see ``collisions``); edge pairs carry the mollifier of [Li et al. 2020].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from taccel_lab.ipc.contact.barrier import (
    contact_potential,
    contact_potential_d1,
    contact_potential_d2,
)
from taccel_lab.ipc.contact.collision_lists import (
    CollisionLists,
    ContactGeometry,
    closest_pair,
    collision_gap,
)
from taccel_lab.ipc.contact.collisions import Collisions
from taccel_lab.ipc.contact.pair_energy import (
    GAUSS_NEWTON,
    mollified_gradient,
    mollifier_terms,
    pair_gradient,
    pair_hessian,
)
from taccel_lab.ipc.device.matrices import mat43d
from taccel_lab.ipc.device.ragged_lists import ListRoom, list_end
from taccel_lab.ipc.device.sums import ReproducibleSums, SumStage, add_vector, lower_to
from taccel_lab.ipc.distance.closest_pairs import ClosestPair
from taccel_lab.ipc.distance.edge_edge_mollifier import (
    edge_edge_cross_sq,
    edge_edge_mollifier,
)
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.potentials.energy import EnergyTerm
from taccel_lab.ipc.potentials.stencil_rows import (
    MOST_PARTS,
    STENCIL_THREADS,
    add_mollifier,
    add_pair_hessian,
    row_parts,
)
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask, Envs, env_at, place_count
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False, "block_dim": STENCIL_THREADS})


@wp.func
def _cross_sq(env: int, nodes: wp.vec4i, positions: wp.array2d(dtype=wp.vec3d)) -> wp.float64:
    x = positions[env]
    return edge_edge_cross_sq(x[nodes[0]], x[nodes[1]], x[nodes[2]], x[nodes[3]])


@wp.func
def is_mollified(
    env: int, nodes: wp.vec4i, threshold: wp.float64, positions: wp.array2d(dtype=wp.vec3d)
) -> bool:
    """Whether an edge pair is parallel enough for the mollifier to act."""
    if threshold <= wp.float64(0.0):
        return False
    return _cross_sq(env, nodes, positions) < threshold


@wp.func
def mollifier(
    env: int, nodes: wp.vec4i, threshold: wp.float64, positions: wp.array2d(dtype=wp.vec3d)
) -> wp.float64:
    """Factor of an edge pair that is nearly parallel; 1 for all other collisions."""
    if threshold <= wp.float64(0.0):
        return wp.float64(1.0)
    return edge_edge_mollifier(_cross_sq(env, nodes, positions), threshold)


@wp.func
def stencil_size(kind: int) -> int:
    """Distinct nodes of a collision kind."""
    if kind == 1:
        return 3
    if kind == 2 or kind == 4:
        return 2
    return 4


@wp.func
def contact_rows(
    env: int,
    at: int,
    pair: ClosestPair,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
) -> mat43d:
    """Gradient [N] of one collision, whose closest pair is given; row i for stencil node i."""
    nodes = lists.stencils[at]
    k = lists.stiffnesses[at]
    d = collision_gap(pair, nodes, lists.insets[at], geometry)
    reach = lists.ranges[at]
    rows = pair_gradient(pair, contact_potential_d1(d, reach, k))
    if is_mollified(env, nodes, lists.thresholds[at], positions):
        rows = mollified_gradient(
            pair,
            positions[env, nodes[0]],
            positions[env, nodes[1]],
            positions[env, nodes[2]],
            positions[env, nodes[3]],
            lists.thresholds[at],
            contact_potential(d, reach, k),
            contact_potential_d1(d, reach, k),
        )
    return rows


@wp.func
def contact_energy(
    env: int,
    at: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
) -> wp.float64:
    """Energy of one collision [J]."""
    nodes = lists.stencils[at]
    pair = closest_pair(env, lists.kinds[at], nodes, positions, geometry)
    gap = collision_gap(pair, nodes, lists.insets[at], geometry)
    energy = contact_potential(gap, lists.ranges[at], lists.stiffnesses[at])
    return energy * mollifier(env, nodes, lists.thresholds[at], positions)


@wp.kernel
def _contact_energy_kernel(
    active: Envs,
    lanes: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    energies: wp.array(dtype=wp.float64),
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(lists.room.starts[env] + lane, list_end(env, lists.room), lanes):
        energies[at] = contact_energy(env, at, lists, geometry, positions)


@wp.func
def add_contact_gradient(
    env: int,
    at: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    gradient: wp.array2d(dtype=wp.vec3d),
    min_distance: wp.array(dtype=wp.float64),
    sums: SumStage,
):
    """Add the gradient [N] of one collision and lower the smallest gap [m]."""
    kind = lists.kinds[at]
    nodes = lists.stencils[at]
    pair = closest_pair(env, kind, nodes, positions, geometry)
    lower_to(min_distance, env, collision_gap(pair, nodes, lists.insets[at], geometry))
    rows = contact_rows(env, at, pair, lists, geometry, positions)
    for i in range(stencil_size(kind)):
        add_vector(env, nodes[i], rows[i], gradient, sums)


@wp.kernel
def _contact_gradient_kernel(
    active: Envs,
    lanes: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    gradient: wp.array2d(dtype=wp.vec3d),
    min_distance: wp.array(dtype=wp.float64),
    sums: SumStage,
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(lists.room.starts[env] + lane, list_end(env, lists.room), lanes):
        add_contact_gradient(env, at, lists, geometry, positions, gradient, min_distance, sums)


@wp.func
def add_contact_hessian(
    env: int,
    at: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    mode: int,
    part: int,
    parts: int,
    system: NewtonSystem,
):
    """Add the blocks [N/m] of one collision to the Newton system, or a part of them, without the
    terms of a mollifier's slope."""
    kind = lists.kinds[at]
    nodes = lists.stencils[at]
    k = lists.stiffnesses[at]
    x0 = positions[env, nodes[0]]
    x1 = positions[env, nodes[1]]
    x2 = positions[env, nodes[2]]
    x3 = positions[env, nodes[3]]
    pair = closest_pair(env, kind, nodes, positions, geometry)
    d = collision_gap(pair, nodes, lists.insets[at], geometry)
    reach = lists.ranges[at]
    e1 = contact_potential_d1(d, reach, k)
    e2 = contact_potential_d2(d, reach, k)
    scale = mollifier(env, nodes, lists.thresholds[at], positions)
    curvature = mode
    if kind == 4:
        # The height over a plane is linear: its first term is the whole, and it is positive.
        curvature = wp.static(GAUSS_NEWTON)
    h = pair_hessian(pair, x0, x1, x2, x3, scale * e1, scale * e2, curvature)
    add_pair_hessian(env, nodes, h, part, parts, system)


@wp.func
def add_mollifier_hessian(
    env: int,
    at: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    mode: int,
    part: int,
    parts: int,
    system: NewtonSystem,
):
    """Add the terms of the slope of one collision's mollifier [N/m], where that acts."""
    nodes = lists.stencils[at]
    threshold = lists.thresholds[at]
    if not is_mollified(env, nodes, threshold, positions):
        return
    x0 = positions[env, nodes[0]]
    x1 = positions[env, nodes[1]]
    x2 = positions[env, nodes[2]]
    x3 = positions[env, nodes[3]]
    k = lists.stiffnesses[at]
    reach = lists.ranges[at]
    pair = closest_pair(env, lists.kinds[at], nodes, positions, geometry)
    d = collision_gap(pair, nodes, lists.insets[at], geometry)
    e0 = contact_potential(d, reach, k)
    e1 = contact_potential_d1(d, reach, k)
    terms = mollifier_terms(pair, x0, x1, x2, x3, threshold, e0, e1, mode)
    add_mollifier(env, nodes, pair.weights, terms, part, parts, system)


@wp.kernel
def _contact_hessian_kernel(
    active: Envs,
    lanes: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    modes: wp.array(dtype=wp.int32),
    parts: int,
    system: NewtonSystem,
):
    place, lane, part = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(lists.room.starts[env] + lane, list_end(env, lists.room), lanes):
        add_contact_hessian(env, at, lists, geometry, positions, modes[env], part, parts, system)


@wp.kernel
def _mollifier_hessian_kernel(
    active: Envs,
    lanes: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    modes: wp.array(dtype=wp.int32),
    parts: int,
    system: NewtonSystem,
):
    place, lane, part = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(lists.room.starts[env] + lane, list_end(env, lists.room), lanes):
        add_mollifier_hessian(env, at, lists, geometry, positions, modes[env], part, parts, system)


class ContactPotential(EnergyTerm):
    """Launches of the barrier energy over a collision set."""

    def __init__(self, model: Model, collisions: Collisions, in_any_order: bool = False) -> None:
        """``in_any_order``: whether gradients shall be the same bits however contacts are listed;
        they are added to zeros then."""
        self.model = model
        shape = (model.env_count, model.node_count)
        self._sums = ReproducibleSums(shape, model.device, in_any_order)
        self.collisions = collisions
        self.energies = wp.zeros(0, dtype=wp.float64, device=model.device)
        """Energy of each collision [J], float64, where it is in the list."""
        collisions.entry_bytes += 8
        collisions.follow(self._fit)

    def _fit(self, before: wp.array) -> None:
        """Make room for the energies of as many collisions as there may be."""
        if len(self.energies) != self.collisions.capacity:
            self.energies = wp.zeros(
                self.collisions.capacity, dtype=wp.float64, device=self.model.device
            )

    @property
    def room(self) -> ListRoom:
        """Room of the collisions."""
        return self.collisions.room

    def _launch(self, kernel: wp.Kernel, active: EnvMask, positions: wp.array, *rest: Any) -> None:
        c, m = self.collisions, self.model
        lanes = lane_count(m.device, place_count(active), c.largest_room)
        launch(kernel, (m.env_count, lanes), active, lanes, c.lists, c.geometry, positions, *rest)

    def write_energies(self, active: EnvMask, positions: wp.array) -> None:
        """Fill ``energies`` of the current collision set [J]."""
        self._launch(_contact_energy_kernel, active, positions, self.energies)

    def add_gradient(
        self, active: EnvMask, positions: wp.array, gradient: wp.array, min_distance: wp.array
    ) -> None:
        """Add d energy / dx [N] of all nodes, soft and kinematic, and lower the minimum gap [m]."""
        for stage in self._sums.stages():
            rest = (gradient, min_distance, stage)
            self._launch(_contact_gradient_kernel, active, positions, *rest)

    def add_hessian(
        self, active: EnvMask, positions: wp.array, system: NewtonSystem, modes: wp.array
    ) -> None:
        """Add the Hessian of the collisions to the Newton system."""
        for launch_part in self.hessian_parts(active, positions, system, modes):
            launch_part()

    def hessian_parts(
        self, active: EnvMask, positions: wp.array, system: NewtonSystem, modes: wp.array
    ) -> list[Callable[[], None]]:
        """Launches of ``add_hessian``, in any order or side by side.

        Few collisions are mollified, and a warp waits for one of them: they have a launch of their
        own, in which several threads share the blocks of each.
        """
        c, m = self.collisions, self.model
        lanes = lane_count(m.device, place_count(active), c.largest_room)
        rest = [c.lists, c.geometry, positions, modes]

        def of_all() -> None:
            parts = row_parts(m.device, place_count(active), lanes)
            inputs = [active, lanes, *rest, parts, system]
            launch(_contact_hessian_kernel, (m.env_count, lanes, parts), *inputs)

        def of_mollified() -> None:
            parts = 1 if m.device.is_cpu else MOST_PARTS
            few = -(-lanes // parts)
            inputs = [active, few, *rest, parts, system]
            launch(_mollifier_hessian_kernel, (m.env_count, few, parts), *inputs)

        plan = m.contact_plan
        return [of_all, of_mollified] if plan.soft_to_soft or len(plan.edge_target) else [of_all]
