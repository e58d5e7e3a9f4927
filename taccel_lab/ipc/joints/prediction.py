# SPDX-License-Identifier: Apache-2.0
"""Closes the joints of bodies that were predicted one by one (``ipc.affine.rigidity``).

From the root of each mechanism on, a body is turned as little as brings its joint's directions onto
those of its parent, and shifted so that their points meet. Joints that close a loop are left to
Newton's method.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import mat43d
from taccel_lab.ipc.joints.kernels import node_controls, second_controls
from taccel_lab.ipc.joints.layout import JointTable
from taccel_lab.ipc.joints.rows import PRISMATIC, REVOLUTE

wp.set_module_options({"enable_backward": False})


@wp.func
def turn_onto(source: wp.vec3d, target: wp.vec3d) -> wp.mat33d:
    """Smallest rotation of one unit vector onto another that is not opposite."""
    n = wp.cross(source, target)
    cross = wp.skew(n)
    scale = wp.float64(1.0) / (wp.float64(1.0) + wp.dot(source, target))
    return wp.identity(n=3, dtype=wp.float64) + cross + scale * (cross * cross)


@wp.func
def _directions(frame: mat43d) -> wp.mat33d:
    return wp.matrix_from_cols(
        wp.normalize(frame[1]),
        wp.normalize(frame[2]),
        wp.normalize(frame[3]),
    )


@wp.func
def placed_child(
    kind: int, child: mat43d, child_weights: wp.mat44d, child_frame: mat43d, parent_frame: mat43d
) -> mat43d:
    """Control vectors of a body moved so that its joint to a placed parent is closed."""
    gap = child_frame[0] - parent_frame[0]
    axis = wp.normalize(parent_frame[1])
    if kind == REVOLUTE:
        turn = turn_onto(wp.normalize(child_frame[1]), axis)
    else:
        turn = _directions(parent_frame) * wp.transpose(_directions(child_frame))
    point = parent_frame[0]
    if kind == PRISMATIC:
        point += wp.dot(axis, gap) * axis
    result = child
    for k in range(1, 4):
        turned = turn * child[k]
        result[k] = turned
        point -= child_weights[0, k] * turned
    result[0] = point
    return result


@wp.kernel
def close_joints_kernel(
    active: wp.array(dtype=wp.int32),
    tree: wp.array(dtype=wp.vec2i),
    poses: wp.array2d(dtype=wp.transformd),
    t: JointTable,
    positions: wp.array2d(dtype=wp.vec3d),
):
    """Move control nodes along ``tree``: joint, and 1 where its second body is the one to move."""
    env = wp.tid()
    if active[env] == 0:
        return
    for entry in range(tree.shape[0]):
        joint = tree[entry][0]
        if t.present[env, joint] != 0:
            w_a = t.first_weights[env % t.first_weights.shape[0], joint]
            w_b = t.second_weights[env % t.second_weights.shape[0], joint]
            a = node_controls(env, t.first_controls[joint], positions)
            b = second_controls(env, joint, t, positions, poses)
            start = t.first_controls[joint]
            placed = placed_child(t.kinds[joint], a, w_a, w_a * a, w_b * b)
            if tree[entry][1] != 0:
                start = t.second_controls[joint]
                placed = placed_child(t.kinds[joint], b, w_b, w_b * b, w_a * a)
            for k in range(4):
                positions[env, start + k] = placed[k]
