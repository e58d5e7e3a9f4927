# SPDX-License-Identifier: Apache-2.0
"""Held surfaces are searched only where another body comes near them.

The glued nodes of a gel move as one rigid piece, with their mount or not at all, and hardly ever
meet anything. A gate for each such patch and each stiff body or ball says whether the other one is
near the patch at all: a box around the patch's convex hull, whose corners alone hold all of it on
straight ways too, against the tree of the body. Faces, edges and nodes whose nodes are all held are
searched only behind an open gate; one small launch decides, in scenes that have such pairs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from taccel_lab.ipc.broad_phase.boxes import Frames, include, rounded_out, widened_margin
from taccel_lab.model import BodyKind, Model

wp.set_module_options({"enable_backward": False})

NO_GATE = -1
"""Gate of what is always searched."""
_FLAT = 1e-6
"""Extent of a patch over its largest one below which it counts as flat or straight; how far it
leaves the plane or line goes into the margin."""
_ROUNDING = 1e-9
"""Rounding of a patch's places over its extent."""
_BIG = wp.constant(wp.float64(1.0e30))


@wp.struct
class Gates:
    """Pairs of a patch and a body that may come near it, [gate_count].

    frames: frame of the body, -1 for a ball; balls: node of the ball, -1 for others; bodies: id of
    the body; starts: range of the patch's corners in ``corners`` (nodes), [gate_count + 1]; slacks:
    what the patch leaves its corners' hull by [m].
    """

    frames: wp.array(dtype=wp.int32)
    balls: wp.array(dtype=wp.int32)
    bodies: wp.array(dtype=wp.int32)
    starts: wp.array(dtype=wp.int32)
    corners: wp.array(dtype=wp.int32)
    slacks: wp.array(dtype=wp.float64)


def hull_corners(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Indices of the corners of the convex hull of points [n, 3] [m], and how far the others may
    lie outside of it [m]: a patch that is flat up to rounding is taken for flat."""
    from scipy.spatial import ConvexHull

    offsets = points - points.mean(axis=0)
    axes = np.linalg.svd(offsets, full_matrices=False)[2]
    along = offsets @ axes.T
    extents = along.max(axis=0) - along.min(axis=0)
    slack = _ROUNDING * float(extents.max())
    dimension = int((extents > _FLAT * extents.max()).sum())
    left_out = np.linalg.norm(along[:, dimension:], axis=1).max(initial=0.0)
    # The hull of the projections; the corners themselves lie off it by as much as the others.
    slack += 2 * float(left_out)
    if dimension == 0 or len(points) <= dimension + 1:
        return np.arange(len(points)), slack
    if dimension == 1:
        return np.array([along[:, 0].argmin(), along[:, 0].argmax()]), slack
    return np.sort(ConvexHull(along[:, :dimension]).vertices), slack


def _patch(model: Model, body: int) -> tuple[np.ndarray, float]:
    """Corner nodes of a soft body's held surface and its slack, in all its rest shapes."""
    faces = model.surface.faces.numpy()[slice(*model.bodies[body].faces)]
    surface = np.unique(faces)
    held = surface[model.free_index.numpy()[surface] < 0]
    if len(held) == 0:
        return held, 0.0
    rest = model.rest_positions.numpy()[:, held]
    shapes = rest[np.unique(rest.reshape(len(rest), -1), axis=0, return_index=True)[1]]
    found = [hull_corners(points) for points in shapes]
    corners = np.unique(np.concatenate([corners for corners, _ in found]))
    return held[corners], max(slack for _, slack in found)


@wp.kernel
def _gate_kernel(
    active: wp.array(dtype=wp.int32),
    gates: Gates,
    face_trees: wp.array(dtype=wp.uint64),
    node_radii: wp.array(dtype=wp.float64),
    present: wp.array2d(dtype=wp.int32),
    margins: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    frames: Frames,
    are_open: wp.array2d(dtype=wp.int32),
):
    env, gate = wp.tid()
    if active[env] == 0:
        return
    are_open[env, gate] = 0
    if present[env, gates.bodies[gate]] == 0:
        return
    low = wp.vec3d(_BIG, _BIG, _BIG)
    high = -low
    reach = margins[env] + gates.slacks[gate]
    ball = gates.balls[gate]
    if ball >= 0:
        centre = positions[env, ball]
        shift = displacements[env, ball]
        for i in range(gates.starts[gate], gates.starts[gate + 1]):
            a = positions[env, gates.corners[i]] - centre
            b = a + displacements[env, gates.corners[i]] - shift
            low = wp.min(low, wp.min(a, b))
            high = wp.max(high, wp.max(a, b))
        reach += node_radii[ball]
        gap_sq = wp.float64(0.0)
        for k in range(3):
            outside = wp.max(wp.max(low[k], -high[k]), wp.float64(0.0))
            gap_sq += outside * outside
        if gap_sq < reach * reach:
            are_open[env, gate] = 1
        return
    frame = gates.frames[gate]
    start = frames.starts[env, frame]
    end = frames.ends[env, frame]
    travel = wp.float64(0.0)
    for i in range(gates.starts[gate], gates.starts[gate + 1]):
        x = positions[env, gates.corners[i]]
        way = displacements[env, gates.corners[i]]
        low, high, travel = include(low, high, travel, x, way, start, end)
    box = rounded_out(low, high, widened_margin(reach, travel, frames.bends[env, frame]))
    # Every edge and vertex of the body lies in the box of one of its faces.
    query = wp.bvh_query_aabb(face_trees[frame], box.lower, box.upper)
    hit = int(0)
    if wp.bvh_query_next(query, hit):
        are_open[env, gate] = 1


class HeldPatches:
    """The gates of a model, and which of them are open."""

    def __init__(self, model: Model) -> None:
        self.model = model
        kinds = [body.kind for body in model.bodies]
        stiff = (BodyKind.AFFINE, BodyKind.KINEMATIC)
        pairs = [
            (i, j)
            for i, j in model.contact_plan.pairs
            if kinds[i] is BodyKind.SOFT and kinds[j] in stiff
        ]
        frames = {target.body: index for index, target in enumerate(model.targets)}
        is_ball = model.surface.node_is_ball.numpy()
        patches = {soft: _patch(model, soft) for soft, _ in pairs}
        self._numbers: dict[tuple[int, int], int] = {}
        rows, corners, starts, slacks = [], [], [0], []
        for soft, other in pairs:
            nodes, slack = patches[soft]
            if len(nodes) == 0:
                continue
            self._numbers[soft, other] = len(rows)
            first = model.bodies[other].nodes[0]
            ball = first if is_ball[first] else -1
            rows.append((-1 if ball >= 0 else frames[other], ball, other))
            corners.append(nodes)
            starts.append(starts[-1] + len(nodes))
            slacks.append(slack)

        def put(values: Sequence | np.ndarray, dtype: type = wp.int32) -> wp.array:
            return wp.array(np.asarray(values), dtype=dtype, device=model.device)

        columns = np.array(rows, dtype=np.int32).reshape(-1, 3).T
        self._gates = Gates()
        self._gates.frames, self._gates.balls, self._gates.bodies = map(put, columns)
        self._gates.starts = put(starts)
        self._gates.corners = put(np.concatenate([np.zeros(0, dtype=np.int32), *corners]))
        self._gates.slacks = put(slacks, wp.float64)
        self._trees = put([t.trees.faces.id if t.trees else 0 for t in model.targets], wp.uint64)
        shape = (model.env_count, len(rows))
        self.are_open = wp.zeros(shape, dtype=wp.int32, device=model.device)
        """1 where a body is near the patch, int32, shape [env_count, gate_count]."""

    def gates_of(self, nodes: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Gate of each primitive with these nodes [n, k] against each body [n]; ``NO_GATE`` where
        one of its nodes is free, or has no patch."""
        bodies = self.model.surface.node_bodies.numpy()[nodes[:, 0]]
        held = (self.model.free_index.numpy()[nodes] < 0).all(axis=1)
        gates = np.full(len(nodes), NO_GATE, dtype=np.int32)
        for (soft, other), number in self._numbers.items():
            gates[held & (bodies == soft) & (others == other)] = number
        return gates

    def update(
        self,
        active: wp.array,
        margins: wp.array,
        positions: wp.array,
        displacements: wp.array,
        frames: Frames,
    ) -> None:
        """Open and close the gates for ways of ``displacements`` [m] and ``margins`` [m]."""
        m = self.model
        if self.are_open.shape[1]:
            wp.launch(
                _gate_kernel,
                dim=self.are_open.shape,
                inputs=[active, self._gates, self._trees, m.surface.node_radii, m.present]
                + [margins, positions, displacements, frames],
                outputs=[self.are_open],
                device=m.device,
            )
