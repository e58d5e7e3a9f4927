# SPDX-License-Identifier: Apache-2.0
"""Search against bodies with a frame, affine and kinematic ones.

Their search trees are built once, in their own frame, and never refitted: the primitives of the
other body are carried into that frame instead, at the start and at the end of the motion. A box
around both ends holds the whole straight path; for a body that turns or stretches it is widened,
because the path is bent in its frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.ipc.broad_phase.boxes import (
    BodyFrame,
    Frames,
    append,
    bend_of,
    include,
    rounded_out,
    widened_margin,
)
from taccel_lab.ipc.broad_phase.hit_queue import any_lane, batch, hit_at, open_queue, put_hit
from taccel_lab.ipc.broad_phase.sieve import edges_may_meet, node_may_meet
from taccel_lab.ipc.device.ragged_lists import ListRoom
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import WARP_THREADS, launch

_SEARCH_THREADS = 64
"""Threads of a block: one that waits for its longest query holds up few. A fifth quicker than 256
where an H200 searches 4,096 pegs."""
_SEARCH_BLOCKS = 10
"""Blocks that a multiprocessor shall have room for, which takes a third of the registers away: all
wait for trees and positions, and the search takes a quarter less."""
wp.set_module_options({"enable_backward": False, "block_dim": _SEARCH_THREADS})

_BIG = wp.constant(wp.float64(1.0e30))


NODE_FACE, FACE_VERTEX, EDGE_EDGE = range(3)
"""What is searched against what; the second belongs to the body with the frame."""


@wp.struct
class TargetTrees:
    """Search trees of all stiff bodies by what they are searched for, [3, frame_count].

    ids: of the trees over faces, vertices and edges, 0 for a frame without a surface; starts:
    number of the first primitive in the model; bodies: id of the body, [frame_count].
    """

    ids: wp.array2d(dtype=wp.uint64)
    starts: wp.array2d(dtype=wp.int32)
    bodies: wp.array(dtype=wp.int32)


@dataclass(frozen=True)
class StiffSearch:
    """All searches against trees of stiff bodies, one launch."""

    jobs: wp.array
    """(primitive, frame, what), vec3i, shape [job_count]."""
    nodes: wp.array
    """Nodes of the primitive of each job, repeated where it has fewer, vec3i, [job_count]."""
    trees: TargetTrees


def stiff_search(model: Model) -> StiffSearch:
    """Nodes and faces against faces and vertices, edges against edges, as the plan says."""
    plan, surface = model.contact_plan, model.surface
    bodies = [model.bodies[target.body] for target in model.targets]

    def put(values: Sequence | np.ndarray, dtype: type) -> wp.array:
        return wp.array(values, dtype=dtype, device=model.device)

    trees = TargetTrees()
    kinds = ("faces", "vertices", "edges")
    ids = [[getattr(t.trees, k).id if t.trees else 0 for t in model.targets] for k in kinds]
    starts = [
        [body.faces[0] for body in bodies],
        [body.nodes[0] for body in bodies],
        [body.edges[0] for body in bodies],
    ]
    shape = (len(kinds), len(bodies))
    trees.ids = put(np.array(ids, dtype=np.uint64).reshape(shape), wp.uint64)
    trees.starts = put(np.array(starts, dtype=np.int32).reshape(shape), wp.int32)
    targets = np.array([target.body for target in model.targets], dtype=np.int32)
    trees.bodies = put(targets, wp.int32)
    faces, edges = surface.faces.numpy(), surface.edges.numpy()
    jobs, nodes = [np.zeros((0, 3), dtype=np.int32)], [np.zeros((0, 3), dtype=np.int32)]
    for what, pairs, corners in (
        (NODE_FACE, plan.node_target, lambda i: np.stack([i, i, i], axis=1)),
        (FACE_VERTEX, plan.face_target, lambda i: faces[i]),
        (EDGE_EDGE, plan.edge_target, lambda i: edges[i][:, [0, 1, 1]]),
    ):
        found = pairs.numpy().reshape(-1, 2)
        jobs.append(np.column_stack([found, np.full(len(found), what)]))
        nodes.append(corners(found[:, 0]).reshape(-1, 3))
    return StiffSearch(
        put(np.concatenate(jobs).astype(np.int32), wp.vec3i),
        put(np.concatenate(nodes).astype(np.int32), wp.vec3i),
        trees,
    )


@wp.func
def _frame_of(
    env: int,
    frame: int,
    affine_count: int,
    first_control: int,
    lengths: wp.array(dtype=wp.float64),
    poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    part: wp.float64,
) -> BodyFrame:
    """Frame of an affine body after a part of its displacement, or of a kinematic one."""
    found = BodyFrame()
    if frame < affine_count:
        y = first_control + 4 * frame
        linear = wp.matrix_from_cols(
            positions[env, y + 1] + part * displacements[env, y + 1],
            positions[env, y + 2] + part * displacements[env, y + 2],
            positions[env, y + 3] + part * displacements[env, y + 3],
        )
        found.inverse = lengths[frame] * wp.inverse(linear)
        found.origin = positions[env, y] + part * displacements[env, y]
    else:
        pose = poses[env, frame - affine_count]
        turn = wp.quat_to_matrix(wp.transform_get_rotation(pose))
        found.inverse = wp.transpose(turn)
        found.origin = wp.transform_get_translation(pose)
    return found


@wp.kernel
def _frames_kernel(
    active: Envs,
    affine_count: int,
    first_control: int,
    lengths: wp.array(dtype=wp.float64),
    start_poses: wp.array2d(dtype=wp.transformd),
    end_poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    frames: Frames,
):
    place, frame = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    start = _frame_of(
        env,
        frame,
        affine_count,
        first_control,
        lengths,
        start_poses,
        positions,
        displacements,
        zero,
    )
    end = _frame_of(
        env, frame, affine_count, first_control, lengths, end_poses, positions, displacements, one
    )
    frames.starts[env, frame] = start
    frames.ends[env, frame] = end
    frames.bends[env, frame] = bend_of(start, end)


def make_frames(model: Model) -> Frames:
    """Room for the frames of all stiff bodies."""
    frames = Frames()
    shape, device = (model.env_count, len(model.targets)), model.device
    frames.starts = wp.zeros(shape, dtype=BodyFrame, device=device)
    frames.ends = wp.zeros(shape, dtype=BodyFrame, device=device)
    frames.bends = wp.zeros(shape, dtype=wp.vec3d, device=device)
    return frames


def update_frames(
    model: Model,
    active: EnvMask,
    poses: list[wp.array],
    positions: wp.array,
    displacements: wp.array,
    frames: Frames,
) -> None:
    """Frames of affine bodies before and after the displacements, of kinematic ones at ``poses``
    (start and end)."""
    inputs = [active, model.affine.count, model.affine.first_control, model.affine.lengths, *poses]
    inputs += [positions, displacements, frames]
    launch(_frames_kernel, (model.env_count, len(model.targets)), *inputs)


@wp.func
def is_absent(
    env: int,
    node: int,
    target: int,
    node_bodies: wp.array(dtype=wp.int32),
    present: wp.array2d(dtype=wp.int32),
) -> bool:
    """Whether either body of a job does not exist in this environment."""
    return present[env, node_bodies[node]] == 0 or present[env, target] == 0


@wp.kernel(launch_bounds=(_SEARCH_THREADS, _SEARCH_BLOCKS))
def _search_kernel(
    active: Envs,
    jobs: wp.array(dtype=wp.vec3i),
    job_nodes: wp.array(dtype=wp.vec3i),
    trees: TargetTrees,
    faces: wp.array(dtype=wp.vec3i),
    edges: wp.array(dtype=wp.vec2i),
    node_bodies: wp.array(dtype=wp.int32),
    present: wp.array2d(dtype=wp.int32),
    margins: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    frames: Frames,
    node_face_room: ListRoom,
    node_faces: wp.array(dtype=wp.vec2i),
    edge_edge_room: ListRoom,
    edge_edges: wp.array(dtype=wp.vec2i),
):
    """The path of a node, face or edge against the primitives of a body."""
    place, i = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    own = wp.min(i, jobs.shape[0] - 1)
    frame = jobs[own][1]
    what = jobs[own][2]
    nodes = job_nodes[own]
    going = i == own and not is_absent(env, nodes[0], trees.bodies[frame], node_bodies, present)
    low = wp.vec3d(_BIG, _BIG, _BIG)
    high = -low
    x = positions[env]
    dx = displacements[env]
    margin = wp.float64(0.0)
    if going:
        travel = wp.float64(0.0)
        start = frames.starts[env, frame]
        end = frames.ends[env, frame]
        corner_count = int(3)
        for k in range(corner_count):
            if k == 0 or nodes[k] != nodes[k - 1]:
                node = nodes[k]
                low, high, travel = include(low, high, travel, x[node], dx[node], start, end)
        margin = widened_margin(margins[env], travel, frames.bends[env, frame])
    box = rounded_out(low, high, margin)
    query = wp.bvh_query_aabb(trees.ids[what, frame], box.lower, box.upper)
    hit = int(0)
    queue = open_queue()
    waiting = int(0)
    more = any_lane(going)
    while more:
        found = int(-1)
        if going:
            going = wp.bvh_query_next(query, hit)
            if going:
                found = hit
        waiting = put_hit(queue, waiting, own, found)
        more = any_lane(going)
        if waiting >= batch() or not more:
            first = wp.max(waiting - batch(), 0)
            pair = hit_at(queue, first, waiting)
            waiting = first
            more = more or waiting > 0
            if pair[0] >= 0:
                job = jobs[pair[0]]
                item = job[0]
                found = trees.starts[job[2], job[1]] + pair[1]
                if job[2] == wp.static(EDGE_EDGE):
                    if edges_may_meet(edges[item], edges[found], margins[env], x, dx):
                        append(env, item, found, edge_edge_room, edge_edges)
                else:
                    node = item
                    face = found
                    if job[2] == wp.static(FACE_VERTEX):
                        node = found
                        face = item
                    if node_may_meet(node, faces[face], margins[env], x, dx):
                        append(env, node, face, node_face_room, node_faces)


def run_search(
    search: StiffSearch,
    model: Model,
    active: EnvMask,
    path: list,
    frames: Frames,
    outputs: list,
) -> None:
    """Append pairs to ``outputs`` (room, pairs of nodes and faces, then of edges); ``path``:
    margins, positions, displacements."""
    if len(search.jobs):
        surface = model.surface
        inputs = [active, search.jobs, search.nodes, search.trees, surface.faces, surface.edges]
        inputs += [surface.node_bodies, model.present, *path, frames, *outputs]
        lanes = WARP_THREADS * -(-len(search.jobs) // WARP_THREADS)
        launch(_search_kernel, (model.env_count, lanes), *inputs)
