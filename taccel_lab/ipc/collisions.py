# SPDX-License-Identifier: Apache-2.0
"""Narrow phase: which features are within dhat, and with which area they count.

Potential of a collision set, area weighted so that it converges with the mesh
[Li, Kaufman, Jiang 2023, Convergent Incremental Potential Contact]:

    1/2 sum_nodes A_x max_faces b(d(x, f)) + 1/4 sum_edge pairs (A_a + A_b) m b(d(a, b))

The maximum over faces is their inclusion-exclusion sum (the paper's "improved max"): each face
counts +1, each edge between two faces -1, each inner vertex +1. Most of these terms are the same
function - the distance to one shared edge or vertex - and cancel, so they are merged here: a
feature enters once with coefficient

    edge:   (faces whose closest feature it is) - 1
    vertex: (faces whose closest feature it is) - (edges whose closest feature it is) + 1

and only where that is not zero. On a convex body exactly one feature of it remains per node.
Edge pairs are those of IPC, mollified where nearly parallel [Li et al. 2020, sec. 4].

A ball is a node with a radius: the gap of a soft face is its distance from the centre less the
radius [Li et al. 2021, C-IPC, thickness], and every face counts with its own area.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.distance.closest_pair import ClosestPair
from taccel_lab.ipc.distance.edge_edge import closest_edge_edge
from taccel_lab.ipc.distance.edge_edge_mollifier import edge_edge_mollifier_threshold
from taccel_lab.ipc.distance.point_edge import closest_point_edge
from taccel_lab.ipc.distance.point_point import closest_point_point
from taccel_lab.ipc.distance.point_triangle import PointTriangleRegion, closest_point_triangle
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})

POINT_TRIANGLE = 0
POINT_EDGE = 1
POINT_POINT = 2
EDGE_EDGE = 3


@wp.func
def closest_pair(
    env: int, kind: int, nodes: wp.vec4i, positions: wp.array2d(dtype=wp.vec3d)
) -> ClosestPair:
    """Closest pair of a collision at the given positions."""
    x0 = positions[env, nodes[0]]
    x1 = positions[env, nodes[1]]
    x2 = positions[env, nodes[2]]
    if kind == 1:
        return closest_point_edge(x0, x1, x2)
    if kind == 2:
        return closest_point_point(x0, x1)
    x3 = positions[env, nodes[3]]
    if kind == 3:
        return closest_edge_edge(x0, x1, x2, x3)
    return closest_point_triangle(x0, x1, x2, x3)


@wp.func
def collision_gap(
    pair: ClosestPair, nodes: wp.vec4i, node_radii: wp.array(dtype=wp.float64)
) -> wp.float64:
    """Gap of a collision [m]: distance less the radius of a ball (stencil node 0)."""
    return wp.sqrt(pair.distance_sq) - node_radii[nodes[0]]


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
def add_collision(
    env: int,
    kind: int,
    nodes: wp.vec4i,
    stiffness: wp.float64,
    threshold: wp.float64,
    counts: wp.array(dtype=wp.int32),
    kinds: wp.array2d(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    stiffnesses: wp.array2d(dtype=wp.float64),
    thresholds: wp.array2d(dtype=wp.float64),
):
    """Append a collision; counts beyond the capacity tell the host to grow and repeat."""
    slot = wp.atomic_add(counts, env, 1)
    if slot < kinds.shape[1]:
        kinds[env, slot] = kind
        stencils[env, slot] = nodes
        stiffnesses[env, slot] = stiffness
        thresholds[env, slot] = threshold


@wp.kernel
def _node_face_kernel(
    active: wp.array(dtype=wp.int32),
    candidate_counts: wp.array(dtype=wp.int32),
    candidates: wp.array2d(dtype=wp.vec2i),
    positions: wp.array2d(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.vec3i),
    edges: wp.array(dtype=wp.vec2i),
    face_edges: wp.array(dtype=wp.vec3i),
    edge_faces: wp.array(dtype=wp.vec2i),
    node_face_starts: wp.array(dtype=wp.int32),
    node_faces: wp.array(dtype=wp.int32),
    node_edge_starts: wp.array(dtype=wp.int32),
    node_edges: wp.array(dtype=wp.int32),
    node_areas: wp.array2d(dtype=wp.float64),
    face_areas: wp.array2d(dtype=wp.float64),
    node_radii: wp.array(dtype=wp.float64),
    kappa: wp.float64,
    dhat: wp.float64,
    counts: wp.array(dtype=wp.int32),
    kinds: wp.array2d(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    stiffnesses: wp.array2d(dtype=wp.float64),
    thresholds: wp.array2d(dtype=wp.float64),
):
    env, slot = wp.tid()
    if active[env] == 0 or slot >= candidate_counts[env]:
        return
    node = candidates[env, slot][0]
    face_id = candidates[env, slot][1]
    face = faces[face_id]
    p = positions[env, node]
    pair = closest_point_triangle(
        p, positions[env, face[0]], positions[env, face[1]], positions[env, face[2]]
    )
    none = wp.float64(-1.0)
    radius = node_radii[node]
    if radius > wp.float64(0.0):
        # A ball is in contact with many faces at once: each counts with its own area.
        reach = radius + dhat
        if pair.distance_sq < reach * reach:
            add_collision(
                env,
                0,
                wp.vec4i(node, face[0], face[1], face[2]),
                kappa * face_areas[env % face_areas.shape[0], face_id],
                none,
                counts,
                kinds,
                stencils,
                stiffnesses,
                thresholds,
            )
        return
    dhat_sq = dhat * dhat
    if pair.distance_sq >= dhat_sq:
        return
    stiffness = wp.float64(0.5) * kappa * node_areas[env % node_areas.shape[0], node]
    if pair.region == wp.static(int(PointTriangleRegion.T)):
        nodes = wp.vec4i(node, face[0], face[1], face[2])
        add_collision(
            env, 0, nodes, stiffness, none, counts, kinds, stencils, stiffnesses, thresholds
        )
    # A face speaks for those of its edges and vertices of which it is the first face. The whole
    # feature is within dhat of the node if any part is, so its first face is a candidate too.
    for k in range(3):
        edge_id = face_edges[face_id][k]
        both = edge_faces[edge_id]
        if both[0] == face_id:
            edge = edges[edge_id]
            on_edge = closest_point_edge(p, positions[env, edge[0]], positions[env, edge[1]])
            if on_edge.free_count == 1 and on_edge.distance_sq < dhat_sq:
                coefficient = int(0)
                if closest_feature_is_edge(pair.region, face_edges[face_id], edge_id):
                    coefficient += 1
                if both[1] >= 0:
                    other = face_region(env, node, faces[both[1]], positions)
                    if closest_feature_is_edge(other, face_edges[both[1]], edge_id):
                        coefficient += 1
                    coefficient -= 1
                if coefficient != 0:
                    add_collision(
                        env,
                        1,
                        wp.vec4i(node, edge[0], edge[1], edge[1]),
                        stiffness * wp.float64(coefficient),
                        none,
                        counts,
                        kinds,
                        stencils,
                        stiffnesses,
                        thresholds,
                    )
        vertex = face[k]
        first = node_face_starts[vertex]
        offset = p - positions[env, vertex]
        if node_faces[first] == face_id and wp.dot(offset, offset) < dhat_sq:
            coefficient = int(0)
            boundary = int(0)
            for i in range(first, node_face_starts[vertex + 1]):
                around = faces[node_faces[i]]
                region = face_region(env, node, around, positions)
                if region < 3 and around[region] == vertex:
                    coefficient += 1
            for i in range(node_edge_starts[vertex], node_edge_starts[vertex + 1]):
                edge = edges[node_edges[i]]
                if edge_faces[node_edges[i]][1] < 0:
                    boundary = 1
                else:
                    far = edge[0] + edge[1] - vertex
                    along = positions[env, far] - positions[env, vertex]
                    if wp.dot(offset, along) <= wp.float64(0.0):
                        coefficient -= 1
            if boundary == 0:
                coefficient += 1
            if coefficient != 0:
                add_collision(
                    env,
                    2,
                    wp.vec4i(node, vertex, vertex, vertex),
                    stiffness * wp.float64(coefficient),
                    none,
                    counts,
                    kinds,
                    stencils,
                    stiffnesses,
                    thresholds,
                )


@wp.kernel
def _edge_edge_kernel(
    active: wp.array(dtype=wp.int32),
    candidate_counts: wp.array(dtype=wp.int32),
    candidates: wp.array2d(dtype=wp.vec2i),
    positions: wp.array2d(dtype=wp.vec3d),
    rest_positions: wp.array2d(dtype=wp.vec3d),
    edges: wp.array(dtype=wp.vec2i),
    edge_areas: wp.array2d(dtype=wp.float64),
    kappa: wp.float64,
    dhat: wp.float64,
    counts: wp.array(dtype=wp.int32),
    kinds: wp.array2d(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    stiffnesses: wp.array2d(dtype=wp.float64),
    thresholds: wp.array2d(dtype=wp.float64),
):
    env, slot = wp.tid()
    if active[env] == 0 or slot >= candidate_counts[env]:
        return
    ids = candidates[env, slot]
    a = edges[ids[0]]
    b = edges[ids[1]]
    pair = closest_edge_edge(
        positions[env, a[0]], positions[env, a[1]], positions[env, b[0]], positions[env, b[1]]
    )
    if pair.distance_sq >= dhat * dhat:
        return
    rest = env % edge_areas.shape[0]
    area = wp.float64(0.25) * (edge_areas[rest, ids[0]] + edge_areas[rest, ids[1]])
    threshold = edge_edge_mollifier_threshold(
        rest_positions[rest, a[0]],
        rest_positions[rest, a[1]],
        rest_positions[rest, b[0]],
        rest_positions[rest, b[1]],
    )
    nodes = wp.vec4i(a[0], a[1], b[0], b[1])
    add_collision(
        env, 3, nodes, kappa * area, threshold, counts, kinds, stencils, stiffnesses, thresholds
    )


class Collisions:
    """The active collisions of each environment at one set of positions."""

    def __init__(self, model: Model, kappa: float, dhat: float, capacity: int = 2048) -> None:
        self.model = model
        self.kappa = kappa
        """Barrier stiffness [Pa]: contact pressure at a gap of about half of dhat."""
        self.dhat = dhat
        """Distance at which contact begins [m]."""
        self.counts = wp.zeros(model.env_count, dtype=wp.int32, device=model.device)
        self.max_count = 0
        self._allocate(capacity)

    def _allocate(self, capacity: int) -> None:
        shape, device = (self.model.env_count, capacity), self.model.device
        self.kinds = wp.zeros(shape, dtype=wp.int32, device=device)
        """POINT_TRIANGLE, POINT_EDGE, POINT_POINT or EDGE_EDGE, shape [env_count, capacity]."""
        self.stencils = wp.zeros(shape, dtype=wp.vec4i, device=device)
        """Nodes; unused entries repeat the last one, shape [env_count, capacity]."""
        self.stiffnesses = wp.zeros(shape, dtype=wp.float64, device=device)
        """kappa * area * coefficient [N], shape [env_count, capacity]."""
        self.thresholds = wp.zeros(shape, dtype=wp.float64, device=device)
        """Mollifier threshold of an edge pair [m^4], -1 for others, [env_count, capacity]."""

    @property
    def capacity(self) -> int:
        return self.kinds.shape[1]

    def update(self, active: wp.array, positions: wp.array, candidates: Candidates) -> None:
        """Collect the collisions among ``candidates`` at ``positions``, for active environments."""
        while True:
            self.counts.zero_()
            self._launch(active, positions, candidates)
            self.max_count = int(self.counts.numpy().max())
            if self.max_count <= self.capacity:
                return
            self._allocate(3 * self.max_count // 2)

    def _launch(self, active: wp.array, positions: wp.array, candidates: Candidates) -> None:
        model, s = self.model, self.model.surface
        outputs = [self.counts, self.kinds, self.stencils, self.stiffnesses, self.thresholds]
        if candidates.max_node_face:
            wp.launch(
                _node_face_kernel,
                dim=(model.env_count, candidates.max_node_face),
                inputs=[active, candidates.node_face_counts, candidates.node_face, positions]
                + [s.faces, s.edges, s.face_edges, s.edge_faces, s.node_face_starts, s.node_faces]
                + [s.node_edge_starts, s.node_edges, s.node_areas, s.face_areas]
                + [s.node_radii, self.kappa, self.dhat],
                outputs=outputs,
                device=model.device,
            )
        if candidates.max_edge_edge:
            wp.launch(
                _edge_edge_kernel,
                dim=(model.env_count, candidates.max_edge_edge),
                inputs=[active, candidates.edge_edge_counts, candidates.edge_edge, positions]
                + [model.rest_positions, s.edges, s.edge_areas, self.kappa, self.dhat],
                outputs=outputs,
                device=model.device,
            )
