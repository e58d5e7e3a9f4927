# SPDX-License-Identifier: Apache-2.0
"""What a collision is: its kind, its stencil of four nodes, its gap.

The gap of two bodies is their distance less what both keep from others, the radius of a ball or the
thickness of a surface [Li et al. 2021, Codimensional IPC]. A body keeps no distance from itself:
the thickness is a layer on its surface, and the neighbours of a node are nearer than that.

In a stencil node 0 belongs to the first primitive and node 3 to the second; entries that a kind
does not need repeat the last one.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.bodies.surface_topology import NO_BALL_INSET
from taccel_lab.ipc.device.ragged_lists import ListRoom, claim_place, list_end
from taccel_lab.ipc.distance.closest_pairs import (
    ClosestPair,
    closest_edge_edge,
    closest_point_edge,
    closest_point_plane,
    closest_point_point,
    closest_point_triangle,
)
from taccel_lab.model import Model
from taccel_lab.model.env_lists import Envs, env_at

wp.set_module_options({"enable_backward": False})

PAIR_THREADS = 64
"""Threads of a block in kernels over pairs: of 256 with their 90 to 180 registers a multiprocessor
of an H200 has room for one, of 64 for half as many threads again."""

POINT_TRIANGLE = 0
POINT_EDGE = 1
POINT_POINT = 2
EDGE_EDGE = 3
POINT_PLANE = 4

_NO_BALL_INSET = wp.constant(wp.float64(NO_BALL_INSET))


@wp.struct
class ContactGeometry:
    """What the gap of a pair needs beside positions; all [node_count], see ``SurfaceArrays``."""

    node_radii: wp.array(dtype=wp.float64)
    node_is_ball: wp.array(dtype=wp.int32)
    node_bodies: wp.array(dtype=wp.int32)
    plane_normals: wp.array(dtype=wp.vec3d)


@wp.struct
class CollisionLists:
    """Collisions of all environments.

    room: where those of each environment are.
    kinds: POINT_TRIANGLE to POINT_PLANE, [capacity] as all below.
    stencils: nodes.
    stiffnesses: kappa * area * coefficient [N].
    thresholds: mollifier threshold of an edge pair [m^4], -1 for others.
    ranges: gap below which the pair repels [m].
    insets: how much nearer than what the bodies keep the pair may come [m], see ``ball_inset``.
    """

    room: ListRoom
    kinds: wp.array(dtype=wp.int32)
    stencils: wp.array(dtype=wp.vec4i)
    stiffnesses: wp.array(dtype=wp.float64)
    thresholds: wp.array(dtype=wp.float64)
    ranges: wp.array(dtype=wp.float64)
    insets: wp.array(dtype=wp.float64)


def contact_geometry(model: Model) -> ContactGeometry:
    """Gather the arrays of a model's surface."""
    geometry = ContactGeometry()
    for name in ContactGeometry.vars:
        setattr(geometry, name, getattr(model.surface, name))
    return geometry


@wp.func
def closest_pair(
    env: int,
    kind: int,
    nodes: wp.vec4i,
    positions: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
) -> ClosestPair:
    """Closest pair of a collision at the given positions [m]."""
    x0 = positions[env, nodes[0]]
    x1 = positions[env, nodes[1]]
    if kind == 2:
        return closest_point_point(x0, x1)
    if kind == 4:
        return closest_point_plane(x0, x1, geometry.plane_normals[nodes[1]])
    x2 = positions[env, nodes[2]]
    if kind == 1:
        return closest_point_edge(x0, x1, x2)
    x3 = positions[env, nodes[3]]
    if kind == 3:
        return closest_edge_edge(x0, x1, x2, x3)
    return closest_point_triangle(x0, x1, x2, x3)


@wp.func
def kept_distance(first: int, second: int, geometry: ContactGeometry) -> wp.float64:
    """Distance [m] that two nodes' bodies keep: sum of radii; none within one body."""
    if geometry.node_bodies[first] == geometry.node_bodies[second]:
        return wp.float64(0.0)
    return geometry.node_radii[first] + geometry.node_radii[second]


@wp.func
def ball_inset(radius: wp.float64, reach_sq: wp.float64) -> wp.float64:
    """``bodies.surface_topology.ball_insets`` of one face [m], from its ``face_reaches_sq``."""
    inset = reach_sq / radius
    return inset * wp.max(wp.float64(1.0) - inset / (_NO_BALL_INSET * radius), wp.float64(0.0))


@wp.func
def collision_gap(
    pair: ClosestPair, nodes: wp.vec4i, inset: wp.float64, geometry: ContactGeometry
) -> wp.float64:
    """Gap of a collision [m]: distance less what the two bodies keep, but for the inset."""
    return wp.sqrt(pair.distance_sq) - (kept_distance(nodes[0], nodes[3], geometry) - inset)


@wp.func
def add_collision(
    env: int,
    kind: int,
    nodes: wp.vec4i,
    stiffness: wp.float64,
    threshold: wp.float64,
    reach: wp.float64,
    inset: wp.float64,
    lists: CollisionLists,
):
    """Append a collision; counts beyond the room tell the host to grow and repeat."""
    at = claim_place(env, lists.room)
    if at >= 0:
        lists.kinds[at] = kind
        lists.stencils[at] = nodes
        lists.stiffnesses[at] = stiffness
        lists.thresholds[at] = threshold
        lists.ranges[at] = reach
        lists.insets[at] = inset


@wp.func
def comes_first(a: int, b: int, lists: CollisionLists) -> bool:
    """Whether collision a precedes collision b by kind and stencil, which no two have in common."""
    if lists.kinds[a] != lists.kinds[b]:
        return lists.kinds[a] < lists.kinds[b]
    one = lists.stencils[a]
    other = lists.stencils[b]
    for i in range(4):
        if one[i] != other[i]:
            return one[i] < other[i]
    return a < b


@wp.kernel
def sort_kernel(active: Envs, lanes: int, found: CollisionLists, lists: CollisionLists):
    """Put each collision where its rank says: as many steps as there are collisions, side by side
    for all of them."""
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    first = found.room.starts[env]
    end = list_end(env, found.room)
    for at in range(first + lane, end, lanes):
        place = first
        for other in range(first, end):
            if comes_first(other, at, found):
                place += 1
        lists.kinds[place] = found.kinds[at]
        lists.stencils[place] = found.stencils[at]
        lists.stiffnesses[place] = found.stiffnesses[at]
        lists.thresholds[place] = found.thresholds[at]
        lists.ranges[place] = found.ranges[at]
        lists.insets[place] = found.insets[at]
