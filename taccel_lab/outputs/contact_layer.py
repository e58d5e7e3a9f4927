# SPDX-License-Identifier: Apache-2.0
"""How thick the layer is that the barrier keeps between bodies in contact.

A barrier holds surfaces a gap apart that depends on the pressure, between zero and dhat. To first
order a press of an obstacle that keeps a gap g(x) is the press of an obstacle without one that went
further by the mean gap: with E the elastic energy and W the barrier's per area, the whole is

    E(d) + integral of min over g of [p g + W(g)],

whose slope over the depth d has, beside the force at d, the gaps weighted with the change of the
pressure p (envelope theorem). The mean weighted with the pressure itself differs from that by less
than a fifth of what the gaps vary: 0.1 % of the force of a ball 1 mm deep.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.contact.barrier import contact_potential_d1
from taccel_lab.ipc.contact.collision_lists import (
    CollisionLists,
    ContactGeometry,
    closest_pair,
    collision_gap,
)
from taccel_lab.ipc.contact.collisions import Collisions
from taccel_lab.ipc.device.ragged_lists import list_end
from taccel_lab.ipc.potentials.contact import mollifier
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _gap_work_kernel(
    lanes: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    work: wp.array2d(dtype=wp.float64),
):
    env, lane = wp.tid()
    total = wp.float64(0.0)
    for at in range(lists.room.starts[env] + lane, list_end(env, lists.room), lanes):
        nodes = lists.stencils[at]
        pair = closest_pair(env, lists.kinds[at], nodes, positions, geometry)
        gap = collision_gap(pair, nodes, lists.insets[at], geometry)
        reach = lists.ranges[at]
        force = -contact_potential_d1(gap, reach, lists.stiffnesses[at])
        force *= mollifier(env, nodes, lists.thresholds[at], positions)
        total += force * gap
    work[env, lane] = total


def gap_work(collisions: Collisions, positions: wp.array) -> wp.array:
    """Sum over all contacts of force times gap [N m], float64, shape [env_count, lanes]: its sum
    over the lanes, divided by a force, is the mean gap.

    ``collisions`` and ``positions`` (vec3d, [env_count, node_count]) are those of a step's end.
    """
    env_count, device = len(collisions.counts), collisions.device
    lanes = lane_count(device, env_count, collisions.largest_room)
    work = wp.empty((env_count, lanes), dtype=wp.float64, device=device)
    inputs = [lanes, collisions.lists, collisions.geometry, positions, work]
    launch(_gap_work_kernel, (env_count, lanes), *inputs)
    return work


@wp.kernel
def _add_gaps_kernel(
    lanes: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    first: int,
    end: int,
    work: wp.array(dtype=wp.float64),
    forces: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    for at in range(lists.room.starts[env] + lane, list_end(env, lists.room), lanes):
        nodes = lists.stencils[at]
        one = nodes[0] >= first and nodes[0] < end
        other = nodes[3] >= first and nodes[3] < end
        if one != other:
            pair = closest_pair(env, lists.kinds[at], nodes, positions, geometry)
            gap = collision_gap(pair, nodes, lists.insets[at], geometry)
            force = -contact_potential_d1(gap, lists.ranges[at], lists.stiffnesses[at])
            force *= mollifier(env, nodes, lists.thresholds[at], positions)
            wp.atomic_add(work, env, force * gap)
            wp.atomic_add(forces, env, force)


@wp.kernel
def _mean_gap_kernel(
    work: wp.array(dtype=wp.float64),
    forces: wp.array(dtype=wp.float64),
    gaps: wp.array(dtype=wp.float64),
):
    env = wp.tid()
    gaps[env] = wp.float64(0.0)
    if forces[env] > wp.float64(0.0):
        gaps[env] = work[env] / forces[env]


def mean_gaps(collisions: Collisions, positions: wp.array, nodes: tuple[int, int]) -> wp.array:
    """Mean gap of the contacts of one body with others, weighted with their forces [m], float64,
    [env_count]; 0 without a contact. Does not wait for the device.

    ``nodes``: first node of the body and the one after its last. ``positions``: see ``gap_work``.
    """
    env_count, device = len(collisions.counts), collisions.device
    lanes = lane_count(device, env_count, collisions.largest_room)
    work, forces, gaps = (wp.zeros(env_count, dtype=wp.float64, device=device) for _ in range(3))
    inputs = [lanes, collisions.lists, collisions.geometry, positions, *nodes, work, forces]
    launch(_add_gaps_kernel, (env_count, lanes), *inputs)
    inputs = [work, forces]
    launch(_mean_gap_kernel, env_count, *inputs, gaps)
    return gaps
