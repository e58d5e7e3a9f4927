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

from taccel_lab.ipc.broad_phase.swept_box import (
    BodyFrame,
    Frames,
    append,
    bend_of,
    include,
    rounded_out,
    widened_margin,
)
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})

_BIG = wp.constant(wp.float64(1.0e30))


@wp.struct
class TargetTrees:
    """Search trees over one kind of primitive of all stiff bodies, by frame.

    ids: of the trees, 0 for a frame without a surface; starts: number of the first primitive in the
    model; bodies: id of the body; [frame_count] each.
    """

    ids: wp.array(dtype=wp.uint64)
    starts: wp.array(dtype=wp.int32)
    bodies: wp.array(dtype=wp.int32)


@dataclass(frozen=True)
class Search:
    """Primitives against trees; not launched when there are no jobs."""

    jobs: wp.array
    """(primitive, frame), vec2i, shape [job_count]."""
    primitives: wp.array
    """Nodes of each primitive that jobs may name, int32, shape [count, nodes_per_primitive]."""
    trees: TargetTrees
    hit_first: bool
    """Whether the body's primitive comes first in a pair."""


def searches(model: Model) -> dict[str, Search]:
    """The searches by kind: nodes and faces against faces and vertices, edges against edges."""
    plan, surface = model.plan, model.surface
    bodies = [model.bodies[target.body] for target in model.targets]

    def put(values: Sequence[int] | np.ndarray, dtype: type) -> wp.array:
        return wp.array(values, dtype=dtype, device=model.device)

    def trees(name: str, starts: list[int]) -> TargetTrees:
        found = TargetTrees()
        ids = [getattr(t.trees, name).id if t.trees else 0 for t in model.targets]
        found.ids, found.starts = put(ids, wp.uint64), put(starts, wp.int32)
        found.bodies = put([t.body for t in model.targets], wp.int32)
        return found

    def search(jobs: wp.array, primitives: np.ndarray, into: TargetTrees, first: bool) -> Search:
        return Search(jobs, put(primitives, wp.int32), into, first)

    every_node = np.arange(model.node_count)[:, None]
    faces = trees("faces", [body.faces[0] for body in bodies])
    vertices = trees("vertices", [body.nodes[0] for body in bodies])
    edges = trees("edges", [body.edges[0] for body in bodies])
    return {
        "node": search(plan.node_target, every_node, faces, False),
        "face": search(plan.face_target, surface.faces.numpy(), vertices, True),
        "edge": search(plan.edge_target, surface.edges.numpy(), edges, False),
    }


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
    active: wp.array(dtype=wp.int32),
    affine_count: int,
    first_control: int,
    lengths: wp.array(dtype=wp.float64),
    start_poses: wp.array2d(dtype=wp.transformd),
    end_poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    frames: Frames,
):
    env, frame = wp.tid()
    if active[env] == 0:
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
    active: wp.array,
    poses: list[wp.array],
    positions: wp.array,
    displacements: wp.array,
    frames: Frames,
) -> None:
    """Frames of affine bodies before and after the displacements, of kinematic ones at ``poses``
    (start and end)."""
    wp.launch(
        _frames_kernel,
        dim=(model.env_count, len(model.targets)),
        inputs=[active, model.affine.count, model.affine.first_control, model.affine.lengths]
        + [*poses, positions, displacements],
        outputs=[frames],
        device=model.device,
    )


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


@wp.kernel
def _search_kernel(
    active: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    primitives: wp.array2d(dtype=wp.int32),
    trees: TargetTrees,
    hit_first: int,
    node_bodies: wp.array(dtype=wp.int32),
    present: wp.array2d(dtype=wp.int32),
    margins: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    frames: Frames,
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """The path of a node, face or edge against the primitives of a body."""
    env, i = wp.tid()
    item = jobs[i][0]
    frame = jobs[i][1]
    if active[env] == 0:
        return
    if is_absent(env, primitives[item, 0], trees.bodies[frame], node_bodies, present):
        return
    low = wp.vec3d(_BIG, _BIG, _BIG)
    high = -low
    travel = wp.float64(0.0)
    start = frames.starts[env, frame]
    end = frames.ends[env, frame]
    for k in range(primitives.shape[1]):
        node = primitives[item, k]
        x = positions[env, node]
        low, high, travel = include(
            low, high, travel, x, displacements[env, node], start, end
        )
    margin = widened_margin(margins[env], travel, frames.bends[env, frame])
    box = rounded_out(low, high, margin)
    query = wp.bvh_query_aabb(trees.ids[frame], box.lower, box.upper)
    hit = int(0)
    while wp.bvh_query_next(query, hit):
        found = trees.starts[frame] + hit
        if hit_first != 0:
            append(env, found, item, counts, pairs)
        else:
            append(env, item, found, counts, pairs)


def run_search(
    search: Search,
    model: Model,
    active: wp.array,
    path: list,
    frames: Frames,
    outputs: list[wp.array],
) -> None:
    """Append pairs to ``outputs`` (counts, pairs); ``path``: margins, positions, displacements."""
    if len(search.jobs):
        wp.launch(
            _search_kernel,
            dim=(model.env_count, len(search.jobs)),
            inputs=[active, search.jobs, search.primitives, search.trees, int(search.hit_first)]
            + [model.surface.node_bodies, model.present, *path, frames],
            outputs=outputs,
            device=model.device,
        )
