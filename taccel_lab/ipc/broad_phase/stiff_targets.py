# SPDX-License-Identifier: Apache-2.0
"""Search against bodies with a frame, affine and kinematic ones.

Their search trees are built once, in their own frame, and never refitted: the primitives of the
other body are carried into that frame instead, at the start and at the end of the motion. A box
around both ends holds the whole straight path; for a body that turns or stretches it is widened,
because the path is bent in its frame.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.broad_phase.swept_box import (
    Frames,
    append,
    include,
    rounded_out,
    widened_margin,
)
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})

_BIG = wp.constant(wp.float64(1.0e30))


@wp.struct
class TargetTrees:
    """Search trees by frame, and where their primitives start in the model's numbers."""

    faces: wp.array(dtype=wp.uint64)
    edges: wp.array(dtype=wp.uint64)
    vertices: wp.array(dtype=wp.uint64)
    face_starts: wp.array(dtype=wp.int32)
    edge_starts: wp.array(dtype=wp.int32)
    node_starts: wp.array(dtype=wp.int32)
    bodies: wp.array(dtype=wp.int32)


def target_trees(model: Model) -> TargetTrees:
    """Gather the trees of a model's stiff bodies; frames without a surface have none."""
    trees = TargetTrees()

    def put(values: list[int], dtype: type) -> wp.array:
        return wp.array(values, dtype=dtype, device=model.device)

    targets = model.targets
    bodies = [model.bodies[t.body] for t in targets]
    for name in ("faces", "edges", "vertices"):
        ids = [getattr(t.trees, name).id if t.trees else 0 for t in targets]
        setattr(trees, name, put(ids, wp.uint64))
    trees.face_starts = put([b.faces[0] for b in bodies], wp.int32)
    trees.edge_starts = put([b.edges[0] for b in bodies], wp.int32)
    trees.node_starts = put([b.nodes[0] for b in bodies], wp.int32)
    trees.bodies = put([t.body for t in targets], wp.int32)
    return trees


@wp.kernel
def _frames_kernel(
    affine_count: int,
    first_control: int,
    lengths: wp.array(dtype=wp.float64),
    poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    frames: Frames,
):
    env, frame = wp.tid()
    if frame < affine_count:
        y = first_control + 4 * frame
        linear = wp.matrix_from_cols(
            positions[env, y + 1] + displacements[env, y + 1],
            positions[env, y + 2] + displacements[env, y + 2],
            positions[env, y + 3] + displacements[env, y + 3],
        )
        frames.inverses[env, frame] = lengths[frame] * wp.inverse(linear)
        frames.origins[env, frame] = positions[env, y] + displacements[env, y]
    else:
        pose = poses[env, frame - affine_count]
        turn = wp.quat_to_matrix(wp.transform_get_rotation(pose))
        frames.inverses[env, frame] = wp.transpose(turn)
        frames.origins[env, frame] = wp.transform_get_translation(pose)


def update_frames(
    model: Model, poses: wp.array, positions: wp.array, displacements: wp.array, frames: Frames
) -> None:
    """Frames of affine bodies at positions + displacements, of kinematic ones at ``poses``."""
    wp.launch(
        _frames_kernel,
        dim=(model.env_count, len(model.targets)),
        inputs=[model.affine.count, model.affine.first_control, model.affine.lengths, poses]
        + [positions, displacements],
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
def _node_kernel(
    active: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    trees: TargetTrees,
    node_bodies: wp.array(dtype=wp.int32),
    present: wp.array2d(dtype=wp.int32),
    margin: wp.float64,
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    start: Frames,
    end: Frames,
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """A node against the faces of a body."""
    env, i = wp.tid()
    node = jobs[i][0]
    frame = jobs[i][1]
    if active[env] == 0 or is_absent(env, node, trees.bodies[frame], node_bodies, present):
        return
    low = wp.vec3d(_BIG, _BIG, _BIG)
    high = -low
    travel = wp.float64(0.0)
    low, high, travel = include(
        low, high, travel, env, frame, node, positions, displacements, start, end
    )
    box = rounded_out(low, high, widened_margin(margin, travel, env, frame, start, end))
    query = wp.bvh_query_aabb(trees.faces[frame], box.lower, box.upper)
    hit = int(0)
    while wp.bvh_query_next(query, hit):
        append(env, node, trees.face_starts[frame] + hit, counts, pairs)


@wp.kernel
def _face_kernel(
    active: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    trees: TargetTrees,
    node_bodies: wp.array(dtype=wp.int32),
    present: wp.array2d(dtype=wp.int32),
    faces: wp.array(dtype=wp.vec3i),
    margin: wp.float64,
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    start: Frames,
    end: Frames,
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """The vertices of a body against a face."""
    env, i = wp.tid()
    face = faces[jobs[i][0]]
    frame = jobs[i][1]
    if active[env] == 0 or is_absent(env, face[0], trees.bodies[frame], node_bodies, present):
        return
    low = wp.vec3d(_BIG, _BIG, _BIG)
    high = -low
    travel = wp.float64(0.0)
    for k in range(3):
        low, high, travel = include(
            low, high, travel, env, frame, face[k], positions, displacements, start, end
        )
    box = rounded_out(low, high, widened_margin(margin, travel, env, frame, start, end))
    query = wp.bvh_query_aabb(trees.vertices[frame], box.lower, box.upper)
    hit = int(0)
    while wp.bvh_query_next(query, hit):
        append(env, trees.node_starts[frame] + hit, jobs[i][0], counts, pairs)


@wp.kernel
def _edge_kernel(
    active: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    trees: TargetTrees,
    node_bodies: wp.array(dtype=wp.int32),
    present: wp.array2d(dtype=wp.int32),
    edges: wp.array(dtype=wp.vec2i),
    margin: wp.float64,
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    start: Frames,
    end: Frames,
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """The edges of a body against an edge."""
    env, i = wp.tid()
    edge = edges[jobs[i][0]]
    frame = jobs[i][1]
    if active[env] == 0 or is_absent(env, edge[0], trees.bodies[frame], node_bodies, present):
        return
    low = wp.vec3d(_BIG, _BIG, _BIG)
    high = -low
    travel = wp.float64(0.0)
    for k in range(2):
        low, high, travel = include(
            low, high, travel, env, frame, edge[k], positions, displacements, start, end
        )
    box = rounded_out(low, high, widened_margin(margin, travel, env, frame, start, end))
    query = wp.bvh_query_aabb(trees.edges[frame], box.lower, box.upper)
    hit = int(0)
    while wp.bvh_query_next(query, hit):
        append(env, jobs[i][0], trees.edge_starts[frame] + hit, counts, pairs)


NODE_JOBS = _node_kernel
FACE_JOBS = _face_kernel
EDGE_JOBS = _edge_kernel
