# SPDX-License-Identifier: Apache-2.0
"""Broad phase: which pairs may come within a margin while all nodes move along straight lines.

A kinematic body's search trees are built once, in its own frame, and never refitted: the soft
primitives are carried into that frame instead, at the start and at the end of the motion. A box
around both ends holds the whole straight path; for a body that turns it is widened, because the
path is bent in its frame. ``margin`` must include how far the body's arc leaves the chord.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.model import KinematicArrays, Model

wp.set_module_options({"enable_backward": False})


@wp.struct
class SweptBox:
    """An FP32 box, rounded outwards, of points in a body frame."""

    lower: wp.vec3
    upper: wp.vec3


@wp.func
def include(
    low: wp.vec3d,
    high: wp.vec3d,
    travel: wp.float64,
    env: int,
    node: int,
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    frame_start: wp.transformd,
    frame_end: wp.transformd,
):
    """Grow a box by both ends of a node's path, in the body frame, and the longest way between."""
    x = positions[env, node]
    a = wp.transform_point(frame_start, x)
    b = wp.transform_point(frame_end, x + displacements[env, node])
    low = wp.min(low, wp.min(a, b))
    high = wp.max(high, wp.max(a, b))
    return low, high, wp.max(travel, wp.length(b - a))


@wp.func
def turned_margin(
    margin: wp.float64, travel: wp.float64, frame_start: wp.transformd, frame_end: wp.transformd
) -> wp.float64:
    """Margin in the frame of a body that turns by an angle w: straight paths are bent there.

    A point of the body that a node has at w0 at the start and at w1 at the end, in the body frame,
    is at A + B on the way, A = (1 - t) w0 and B = t Q w1; the box knows A + Q^-1 B. If A + B is
    shorter than the margin m, the other is shorter than m + 2 sin(w / 2) |A|, and from the travel
    D = |w1 - w0| follows |A| <= (D / 4 + m) / cos(w / 2). Own derivation.
    """
    turn = wp.transform_get_rotation(frame_end) * wp.quat_inverse(
        wp.transform_get_rotation(frame_start)
    )
    sine = wp.length(wp.vec3d(turn[0], turn[1], turn[2]))
    tangent = sine / wp.max(wp.abs(turn[3]), wp.float64(1.0e-6))
    half = wp.float64(0.5)
    return margin + tangent * (wp.float64(2.0) * margin + half * travel)


@wp.func
def rounded_out(low: wp.vec3d, high: wp.vec3d, margin: wp.float64) -> SweptBox:
    """FP32 box that holds [low - margin, high + margin] whatever the rounding."""
    box = SweptBox()
    for k in range(3):
        a = low[k] - margin
        b = high[k] + margin
        # One FP32 rounding is at most 6e-8 of the value; twice that is safe.
        slack = wp.float64(1.2e-7)
        box.lower[k] = wp.float32(a - slack * wp.abs(a))
        box.upper[k] = wp.float32(b + slack * wp.abs(b))
    return box


@wp.func
def append(
    env: int,
    a: int,
    b: int,
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """Append a pair; counts beyond the capacity tell the host to grow and repeat."""
    slot = wp.atomic_add(counts, env, 1)
    if slot < pairs.shape[1]:
        pairs[env, slot] = wp.vec2i(a, b)


@wp.kernel
def _node_face_kernel(
    active: wp.array(dtype=wp.int32),
    body: int,
    bvh: wp.uint64,
    first: int,
    margin: wp.float64,
    nodes: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    poses_start: wp.array2d(dtype=wp.transformd),
    poses_end: wp.array2d(dtype=wp.transformd),
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """Soft node against the body's faces."""
    env, i = wp.tid()
    if active[env] == 0:
        return
    node = nodes[i]
    start = wp.transform_inverse(poses_start[env, body])
    end = wp.transform_inverse(poses_end[env, body])
    big = wp.float64(1.0e30)
    travel = wp.float64(0.0)
    low = wp.vec3d(big, big, big)
    high = -low
    low, high, travel = include(low, high, travel, env, node, positions, displacements, start, end)
    box = rounded_out(low, high, turned_margin(margin, travel, start, end))
    query = wp.bvh_query_aabb(bvh, box.lower, box.upper)
    hit = int(0)
    while wp.bvh_query_next(query, hit):
        append(env, node, first + hit, counts, pairs)


@wp.kernel
def _vertex_face_kernel(
    active: wp.array(dtype=wp.int32),
    body: int,
    bvh: wp.uint64,
    first: int,
    margin: wp.float64,
    face_start: int,
    faces: wp.array(dtype=wp.vec3i),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    poses_start: wp.array2d(dtype=wp.transformd),
    poses_end: wp.array2d(dtype=wp.transformd),
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """The body's vertices against a soft face."""
    env, i = wp.tid()
    if active[env] == 0:
        return
    face = faces[face_start + i]
    start = wp.transform_inverse(poses_start[env, body])
    end = wp.transform_inverse(poses_end[env, body])
    big = wp.float64(1.0e30)
    travel = wp.float64(0.0)
    low = wp.vec3d(big, big, big)
    high = -low
    for k in range(3):
        low, high, travel = include(
            low, high, travel, env, face[k], positions, displacements, start, end
        )
    box = rounded_out(low, high, turned_margin(margin, travel, start, end))
    query = wp.bvh_query_aabb(bvh, box.lower, box.upper)
    hit = int(0)
    while wp.bvh_query_next(query, hit):
        append(env, first + hit, face_start + i, counts, pairs)


@wp.kernel
def _edge_edge_kernel(
    active: wp.array(dtype=wp.int32),
    body: int,
    bvh: wp.uint64,
    first: int,
    margin: wp.float64,
    edge_start: int,
    edges: wp.array(dtype=wp.vec2i),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    poses_start: wp.array2d(dtype=wp.transformd),
    poses_end: wp.array2d(dtype=wp.transformd),
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """The body's edges against a soft edge."""
    env, i = wp.tid()
    if active[env] == 0:
        return
    edge = edges[edge_start + i]
    start = wp.transform_inverse(poses_start[env, body])
    end = wp.transform_inverse(poses_end[env, body])
    big = wp.float64(1.0e30)
    travel = wp.float64(0.0)
    low = wp.vec3d(big, big, big)
    high = -low
    for k in range(2):
        low, high, travel = include(
            low, high, travel, env, edge[k], positions, displacements, start, end
        )
    box = rounded_out(low, high, turned_margin(margin, travel, start, end))
    query = wp.bvh_query_aabb(bvh, box.lower, box.upper)
    hit = int(0)
    while wp.bvh_query_next(query, hit):
        append(env, edge_start + i, first + hit, counts, pairs)


@wp.kernel
def _ball_face_kernel(
    active: wp.array(dtype=wp.int32),
    ball: int,
    radius: wp.float64,
    margin: wp.float64,
    face_start: int,
    faces: wp.array(dtype=wp.vec3i),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """A ball against a soft face: a box around the face's path as seen from the ball."""
    env, i = wp.tid()
    if active[env] == 0:
        return
    face = faces[face_start + i]
    centre = positions[env, ball]
    shift = displacements[env, ball]
    big = wp.float64(1.0e30)
    low = wp.vec3d(big, big, big)
    high = -low
    for k in range(3):
        a = positions[env, face[k]] - centre
        b = a + displacements[env, face[k]] - shift
        low = wp.min(low, wp.min(a, b))
        high = wp.max(high, wp.max(a, b))
    gap_sq = wp.float64(0.0)
    for k in range(3):
        outside = wp.max(wp.max(low[k], -high[k]), wp.float64(0.0))
        gap_sq += outside * outside
    reach = radius + margin
    if gap_sq < reach * reach:
        append(env, ball, face_start + i, counts, pairs)


class Candidates:
    """Candidate pairs per environment; the lists grow when one overflows, nothing is dropped."""

    def __init__(self, model: Model, capacity: int = 4096) -> None:
        self.model = model
        self.node_face_counts = wp.zeros(model.env_count, dtype=wp.int32, device=model.device)
        self.edge_edge_counts = wp.zeros(model.env_count, dtype=wp.int32, device=model.device)
        self._allocate(capacity, capacity)

    def _allocate(self, node_face_capacity: int, edge_edge_capacity: int) -> None:
        env_count, device = self.model.env_count, self.model.device
        self.node_face = wp.zeros((env_count, node_face_capacity), dtype=wp.vec2i, device=device)
        """(node, face) pairs, shape [env_count, capacity]."""
        self.edge_edge = wp.zeros((env_count, edge_edge_capacity), dtype=wp.vec2i, device=device)
        """(soft edge, body edge) pairs, shape [env_count, capacity]."""

    def update(
        self,
        active: wp.array,
        positions: wp.array,
        displacements: wp.array,
        poses_start: wp.array,
        poses_end: wp.array,
        margin: float,
    ) -> None:
        """Find all pairs that may come within ``margin`` [m] on the way to x + displacement."""
        while True:
            self.node_face_counts.zero_()
            self.edge_edge_counts.zero_()
            for index, body in enumerate(self.model.kinematic):
                self._query_body(
                    index, body, active, positions, displacements, poses_start, poses_end, margin
                )
            self.max_node_face = int(self.node_face_counts.numpy().max())
            self.max_edge_edge = int(self.edge_edge_counts.numpy().max())
            if (
                self.max_node_face <= self.node_face.shape[1]
                and self.max_edge_edge <= self.edge_edge.shape[1]
            ):
                return
            self._allocate(
                max(self.node_face.shape[1], 3 * self.max_node_face // 2),
                max(self.edge_edge.shape[1], 3 * self.max_edge_edge // 2),
            )

    def _query_body(
        self,
        index: int,
        body: KinematicArrays,
        active: wp.array,
        positions: wp.array,
        displacements: wp.array,
        poses_start: wp.array,
        poses_end: wp.array,
        margin: float,
    ) -> None:
        model, surface = self.model, self.model.surface
        trees = body.trees
        if trees is None:
            first, last = model.soft_faces
            wp.launch(
                _ball_face_kernel,
                dim=(model.env_count, last - first),
                inputs=[active, body.node_start, body.radius_m, margin, first, surface.faces]
                + [positions, displacements],
                outputs=[self.node_face_counts, self.node_face],
                device=model.device,
            )
            return
        motion = [positions, displacements, poses_start, poses_end]
        wp.launch(
            _node_face_kernel,
            dim=(model.env_count, model.soft_surface_nodes.shape[0]),
            inputs=[active, index, trees.faces.id, body.face_start, margin]
            + [model.soft_surface_nodes, *motion],
            outputs=[self.node_face_counts, self.node_face],
            device=model.device,
        )
        first, last = model.soft_faces
        wp.launch(
            _vertex_face_kernel,
            dim=(model.env_count, last - first),
            inputs=[active, index, trees.vertices.id, body.node_start, margin]
            + [first, surface.faces, *motion],
            outputs=[self.node_face_counts, self.node_face],
            device=model.device,
        )
        first, last = model.soft_edges
        wp.launch(
            _edge_edge_kernel,
            dim=(model.env_count, last - first),
            inputs=[active, index, trees.edges.id, body.edge_start, margin]
            + [first, surface.edges, *motion],
            outputs=[self.edge_edge_counts, self.edge_edge],
            device=model.device,
        )
