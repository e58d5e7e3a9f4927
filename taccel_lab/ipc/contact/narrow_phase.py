# SPDX-License-Identifier: Apache-2.0
"""Narrow phase: which features are in reach, with which area they count and from which gap on.

See ``collisions`` for the potential. Candidates are unordered and may be pairs within one body; a
node and a face, or two edges, that share a node are never a collision.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.contact.collision_lists import (
    PAIR_THREADS,
    CollisionLists,
    ContactGeometry,
    add_collision,
    ball_inset,
    kept_distance,
)
from taccel_lab.ipc.device.ragged_lists import ListRoom, list_end
from taccel_lab.ipc.distance.closest_pairs import (
    PointTriangleRegion,
    closest_edge_edge,
    closest_point_edge,
    closest_point_triangle,
    edge_edge_distance_sq,
)
from taccel_lab.ipc.distance.edge_edge_mollifier import edge_edge_mollifier_threshold
from taccel_lab.model.env_lists import Envs, env_at

wp.set_module_options({"enable_backward": False, "block_dim": PAIR_THREADS})


@wp.struct
class ContactSurface:
    """Collision surfaces and what decides the weight of a pair.

    faces to node_edges: see ``SurfaceTopology``; the areas [m^2], [rest_count, ...].
    face_reaches_sq: see ``SurfaceArrays`` [m^2], [rest_count, face_count].
    rest_positions: [m], [rest_count, node_count].
    self_ranges: gap from which a node repels its own body [m], [rest_count, node_count].
    body_ranks: of two bodies the nodes of the one that ranks higher measure the contact, of both
        when they rank the same, [body_count].
    body_kappas: barrier stiffness that a body asks for [Pa], 0 for none, and in the last column
        that between bodies that ask for none, [1 or env_count, body_count + 1]; of a pair the
        larger one counts (``pair_kappa``).
    dhat: range of the contact [m]; guard: range of the guard [m].
    """

    faces: wp.array(dtype=wp.vec3i)
    edges: wp.array(dtype=wp.vec2i)
    face_edges: wp.array(dtype=wp.vec3i)
    edge_faces: wp.array(dtype=wp.vec2i)
    node_face_starts: wp.array(dtype=wp.int32)
    node_faces: wp.array(dtype=wp.int32)
    node_edge_starts: wp.array(dtype=wp.int32)
    node_edges: wp.array(dtype=wp.int32)
    node_areas: wp.array2d(dtype=wp.float64)
    edge_areas: wp.array2d(dtype=wp.float64)
    face_areas: wp.array2d(dtype=wp.float64)
    face_reaches_sq: wp.array2d(dtype=wp.float64)
    rest_positions: wp.array2d(dtype=wp.vec3d)
    self_ranges: wp.array2d(dtype=wp.float64)
    body_ranks: wp.array(dtype=wp.int32)
    body_kappas: wp.array2d(dtype=wp.float64)
    dhat: wp.float64
    guard: wp.float64


@wp.func
def pair_kappa(env: int, first: int, second: int, surface: ContactSurface) -> wp.float64:
    """Barrier stiffness of the contact of two bodies [Pa]: it is their own, whatever else is in the
    scene."""
    row = env % surface.body_kappas.shape[0]
    kappa = wp.max(surface.body_kappas[row, first], surface.body_kappas[row, second])
    if kappa > wp.float64(0.0):
        return kappa
    return surface.body_kappas[row, surface.body_kappas.shape[1] - 1]


@wp.func
def face_region(env: int, node: int, face: wp.vec3i, positions: wp.array2d(dtype=wp.vec3d)) -> int:
    """Feature of a face that is closest to a node (PointTriangleRegion)."""
    return closest_point_triangle(
        positions[env, node],
        positions[env, face[0]],
        positions[env, face[1]],
        positions[env, face[2]],
    ).region


@wp.func
def closest_feature_is_edge(region: int, face_edges: wp.vec3i, edge: int) -> bool:
    """Whether a face region is the inside of the given edge."""
    return region >= 3 and region <= 5 and face_edges[region - 3] == edge


@wp.func
def holds(face: wp.vec3i, node: int) -> bool:
    """Whether a node is a corner of a face: such a face does not exist for the node."""
    return face[0] == node or face[1] == node or face[2] == node


@wp.func
def faces_of_edge(edge: int, node: int, surface: ContactSurface) -> wp.vec2i:
    """The one or two faces of an edge that exist for a node; -1 for none, which comes last."""
    both = surface.edge_faces[edge]
    first = both[0]
    second = both[1]
    if second >= 0 and holds(surface.faces[second], node):
        second = -1
    if first >= 0 and holds(surface.faces[first], node):
        first = second
        second = -1
    return wp.vec2i(first, second)


@wp.func
def edge_coefficient(
    env: int,
    node: int,
    edge: int,
    both: wp.vec2i,
    surface: ContactSurface,
    positions: wp.array2d(dtype=wp.vec3d),
) -> int:
    """(Faces whose closest feature is the edge) - (1 if it is shared)."""
    count = int(0)
    region = face_region(env, node, surface.faces[both[0]], positions)
    if closest_feature_is_edge(region, surface.face_edges[both[0]], edge):
        count += 1
    if both[1] >= 0:
        region = face_region(env, node, surface.faces[both[1]], positions)
        if closest_feature_is_edge(region, surface.face_edges[both[1]], edge):
            count += 1
        count -= 1
    return count


@wp.func
def vertex_coefficient(
    env: int,
    node: int,
    vertex: int,
    surface: ContactSurface,
    positions: wp.array2d(dtype=wp.vec3d),
) -> int:
    """(Faces whose closest feature it is) - (shared edges whose closest feature it is)
    + 1 - (faces around it) + (shared edges at it).

    The last three are what inclusion-exclusion leaves at a vertex: 1 inside a surface, 0 on its
    rim. Faces that hold the node are absent, as if the surface ended there.
    """
    count = int(1)
    for i in range(surface.node_face_starts[vertex], surface.node_face_starts[vertex + 1]):
        around = surface.faces[surface.node_faces[i]]
        if not holds(around, node):
            count -= 1
            region = face_region(env, node, around, positions)
            if region < 3 and around[region] == vertex:
                count += 1
    offset = positions[env, node] - positions[env, vertex]
    for i in range(surface.node_edge_starts[vertex], surface.node_edge_starts[vertex + 1]):
        edge_id = surface.node_edges[i]
        if faces_of_edge(edge_id, node, surface)[1] >= 0:
            count += 1
            edge = surface.edges[edge_id]
            far = edge[0] + edge[1] - vertex
            along = positions[env, far] - positions[env, vertex]
            if wp.dot(offset, along) <= wp.float64(0.0):
                count -= 1
    return count


@wp.func
def first_face(vertex: int, node: int, surface: ContactSurface) -> int:
    """First face around a vertex that exists for a node."""
    for i in range(surface.node_face_starts[vertex], surface.node_face_starts[vertex + 1]):
        face = surface.node_faces[i]
        if not holds(surface.faces[face], node):
            return face
    return -1


@wp.func
def node_range(
    rest: int, node: int, node_body: int, face_body: int, surface: ContactSurface
) -> wp.vec2d:
    """Gap from which a node repels a face [m] and the share of its area that counts."""
    one = wp.float64(1.0)
    half = wp.float64(0.5)
    if node_body == face_body:
        return wp.vec2d(surface.self_ranges[rest, node], half)
    difference = surface.body_ranks[node_body] - surface.body_ranks[face_body]
    if difference == 0:
        return wp.vec2d(surface.dhat, half)
    if difference < 0:
        return wp.vec2d(surface.guard, one)
    return wp.vec2d(surface.dhat, one)


@wp.func
def collect_ball_face(
    env: int,
    ball: int,
    face_id: int,
    positions: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    surface: ContactSurface,
    lists: CollisionLists,
):
    """Nodes of a surface near a ball, each with its area, and the guard: faces near the ball, each
    with its area, which a small ball would otherwise get through between the nodes.

    With a tenth of their areas, faces let a ball between the nodes of a coarse gel sit so deep in
    the guard's range that steps had to be halved: of fifty rough presses by ten bodies 86 % were
    solved in one part, with whole faces 92 %. Faces of quadratic elements stay back by an inset.
    """
    face = surface.faces[face_id]
    centre = positions[env, ball]
    none = wp.float64(-1.0)
    zero = wp.float64(0.0)
    kept = kept_distance(ball, face[0], geometry)
    rest = env % surface.node_areas.shape[0]
    kappa = pair_kappa(env, geometry.node_bodies[ball], geometry.node_bodies[face[0]], surface)
    # A face speaks for those of its corners of which it is the first face.
    reach = kept + surface.dhat
    for k in range(3):
        node = face[k]
        if surface.node_faces[surface.node_face_starts[node]] == face_id:
            if wp.length_sq(centre - positions[env, node]) < reach * reach:
                stiffness = kappa * surface.node_areas[rest, node]
                nodes = wp.vec4i(ball, node, node, node)
                add_collision(env, 2, nodes, stiffness, none, surface.dhat, zero, lists)
    pair = closest_point_triangle(
        centre, positions[env, face[0]], positions[env, face[1]], positions[env, face[2]]
    )
    inset = ball_inset(geometry.node_radii[ball], surface.face_reaches_sq[rest, face_id])
    reach = kept - inset + surface.guard
    if pair.distance_sq < reach * reach:
        area = surface.face_areas[rest, face_id]
        stiffness = kappa * area
        nodes = wp.vec4i(ball, face[0], face[1], face[2])
        add_collision(env, 0, nodes, stiffness, none, surface.guard, inset, lists)


@wp.func
def collect_node_face(
    env: int,
    candidate: wp.vec2i,
    positions: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    surface: ContactSurface,
    lists: CollisionLists,
):
    """Merged features of faces near nodes, and what is near balls."""
    node = candidate[0]
    face_id = candidate[1]
    if geometry.node_is_ball[node] != 0:
        collect_ball_face(env, node, face_id, positions, geometry, surface, lists)
        return
    face = surface.faces[face_id]
    if holds(face, node):
        return
    p = positions[env, node]
    pair = closest_point_triangle(
        p, positions[env, face[0]], positions[env, face[1]], positions[env, face[2]]
    )
    none = wp.float64(-1.0)
    zero = wp.float64(0.0)
    kept = kept_distance(node, face[0], geometry)
    rest = env % surface.node_areas.shape[0]
    node_body = geometry.node_bodies[node]
    face_body = geometry.node_bodies[face[0]]
    weight = node_range(rest, node, node_body, face_body, surface)
    gap = weight[0]
    reach_sq = (kept + gap) * (kept + gap)
    if pair.distance_sq >= reach_sq:
        return
    kappa = pair_kappa(env, node_body, face_body, surface)
    stiffness = weight[1] * kappa * surface.node_areas[rest, node]
    if pair.region == wp.static(int(PointTriangleRegion.T)):
        nodes = wp.vec4i(node, face[0], face[1], face[2])
        add_collision(env, 0, nodes, stiffness, none, gap, zero, lists)
    # A face speaks for those of its edges and vertices of which it is the first face. The whole
    # feature is within reach of the node if any part is, so its first face is a candidate too.
    for k in range(3):
        edge_id = surface.face_edges[face_id][k]
        both = faces_of_edge(edge_id, node, surface)
        if both[0] == face_id:
            edge = surface.edges[edge_id]
            on_edge = closest_point_edge(p, positions[env, edge[0]], positions[env, edge[1]])
            if on_edge.free_count == 1 and on_edge.distance_sq < reach_sq:
                count = edge_coefficient(env, node, edge_id, both, surface, positions)
                if count != 0:
                    nodes = wp.vec4i(node, edge[0], edge[1], edge[1])
                    signed = stiffness * wp.float64(count)
                    add_collision(env, 1, nodes, signed, none, gap, zero, lists)
        vertex = face[k]
        if (
            wp.length_sq(p - positions[env, vertex]) < reach_sq
            and first_face(vertex, node, surface) == face_id
        ):
            count = vertex_coefficient(env, node, vertex, surface, positions)
            if count != 0:
                nodes = wp.vec4i(node, vertex, vertex, vertex)
                signed = stiffness * wp.float64(count)
                add_collision(env, 2, nodes, signed, none, gap, zero, lists)


@wp.func
def collect_edge_edge(
    env: int,
    candidate: wp.vec2i,
    positions: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    surface: ContactSurface,
    lists: CollisionLists,
):
    """Pairs of edges: they only guard."""
    a = surface.edges[candidate[0]]
    b = surface.edges[candidate[1]]
    if a[0] == b[0] or a[0] == b[1] or a[1] == b[0] or a[1] == b[1]:
        return
    rest = env % surface.edge_areas.shape[0]
    pair = closest_edge_edge(
        positions[env, a[0]], positions[env, a[1]], positions[env, b[0]], positions[env, b[1]]
    )
    gap = surface.guard
    kept = kept_distance(a[0], b[0], geometry)
    reach = kept + gap
    if pair.distance_sq >= reach * reach:
        return
    ra0 = surface.rest_positions[rest, a[0]]
    ra1 = surface.rest_positions[rest, a[1]]
    rb0 = surface.rest_positions[rest, b[0]]
    rb1 = surface.rest_positions[rest, b[1]]
    if geometry.node_bodies[a[0]] == geometry.node_bodies[b[0]]:
        # Edges that are neighbours at rest must not repel each other there.
        apart = wp.float64(0.5) * wp.sqrt(edge_edge_distance_sq(ra0, ra1, rb0, rb1))
        gap = wp.min(gap, apart)
        if pair.distance_sq >= gap * gap:
            return
    # Only where both edges are is there a contact: the smaller area bounds it.
    area = wp.float64(0.5) * wp.min(
        surface.edge_areas[rest, candidate[0]], surface.edge_areas[rest, candidate[1]]
    )
    threshold = edge_edge_mollifier_threshold(ra0, ra1, rb0, rb1)
    nodes = wp.vec4i(a[0], a[1], b[0], b[1])
    kappa = pair_kappa(env, geometry.node_bodies[a[0]], geometry.node_bodies[b[0]], surface)
    add_collision(env, 3, nodes, kappa * area, threshold, gap, wp.float64(0.0), lists)


@wp.kernel
def node_face_kernel(
    active: Envs,
    lanes: int,
    room: ListRoom,
    candidates: wp.array(dtype=wp.vec2i),
    positions: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    surface: ContactSurface,
    lists: CollisionLists,
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(room.starts[env] + lane, list_end(env, room), lanes):
        collect_node_face(env, candidates[at], positions, geometry, surface, lists)


@wp.kernel
def edge_edge_kernel(
    active: Envs,
    lanes: int,
    room: ListRoom,
    candidates: wp.array(dtype=wp.vec2i),
    positions: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    surface: ContactSurface,
    lists: CollisionLists,
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(room.starts[env] + lane, list_end(env, room), lanes):
        collect_edge_edge(env, candidates[at], positions, geometry, surface, lists)


@wp.kernel
def node_plane_kernel(
    active: Envs,
    pairs: wp.array(dtype=wp.vec2i),
    present: wp.array2d(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    surface: ContactSurface,
    lists: CollisionLists,
):
    """Nodes near planes; a plane has no nodes, so the whole area of the node counts."""
    place, i = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    node = pairs[i][0]
    plane = pairs[i][1]
    first = geometry.node_bodies[node]
    second = geometry.node_bodies[plane]
    if present[env, first] == 0 or present[env, second] == 0:
        return
    height = wp.dot(positions[env, node] - positions[env, plane], geometry.plane_normals[plane])
    if height < kept_distance(node, plane, geometry) + surface.dhat:
        rest = env % surface.node_areas.shape[0]
        stiffness = pair_kappa(env, first, second, surface) * surface.node_areas[rest, node]
        nodes = wp.vec4i(node, plane, plane, plane)
        none = wp.float64(-1.0)
        zero = wp.float64(0.0)
        add_collision(env, 4, nodes, stiffness, none, surface.dhat, zero, lists)
