# SPDX-License-Identifier: Apache-2.0
"""Kernels of joints: rows and their derivatives by control node, then energy, force and matrix.

Entry 0..3 of a row's derivative belongs to the control nodes of the first body, 4..7 to those of
the second. Kernels that add to shared arrays run over joints of which no two share a body.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.bodies.joints import ROW_COUNT
from taccel_lab.ipc.device.matrices import mat43d
from taccel_lab.ipc.joints.layout import JointTable
from taccel_lab.ipc.joints.rows import (
    COORDINATE_ROW,
    REVOLUTE,
    Response,
    bound_response,
    drive_response,
    equality_response,
    joint_row,
    matrix_row,
    unwrapped,
    with_row,
)
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem, add_block
from taccel_lab.model.env_lists import Envs, env_at

wp.set_module_options({"enable_backward": False})

_COORDINATE = wp.constant(COORDINATE_ROW)
_ROWS = wp.constant(ROW_COUNT)
_EPSILON = wp.constant(wp.float64(2.0**-52))


@wp.struct
class JointStep:
    """What belongs to a step, arrays [env_count, joint_count] unless said otherwise."""

    dts: wp.array(dtype=wp.float64)
    """Length of the step [s], shape [env_count]."""
    starts: wp.array2d(dtype=wp.float64)
    """Coordinate at the start of the step [rad or m]."""
    targets: wp.array2d(dtype=wp.float64)
    """Target of the drive [rad, m, rad/s or m/s]."""
    multipliers: wp.array3d(dtype=wp.float64)
    """Shape [env_count, joint_count, ROW_COUNT] [N; N m for the angle]."""


@wp.func
def node_controls(env: int, start: int, positions: wp.array2d(dtype=wp.vec3d)) -> mat43d:
    """Control vectors of an affine body as rows."""
    y = mat43d()
    for k in range(4):
        y = with_row(y, k, positions[env, start + k])
    return y


@wp.func
def _pose_controls(pose: wp.transformd) -> mat43d:
    """Origin and axes of a kinematic frame."""
    y = mat43d()
    r = wp.quat_to_matrix(wp.transform_get_rotation(pose))
    y = with_row(y, 0, wp.transform_get_translation(pose))
    for k in range(3):
        y = with_row(y, k + 1, wp.vec3d(r[0, k], r[1, k], r[2, k]))
    return y


@wp.func
def _world_controls() -> mat43d:
    y = mat43d()
    for k in range(3):
        y[k + 1, k] = wp.float64(1.0)
    return y


@wp.func
def second_controls(
    env: int,
    joint: int,
    t: JointTable,
    positions: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
) -> mat43d:
    """Control vectors of what a joint connects its first body to: affine, kinematic or world."""
    start = t.second_controls[joint]
    if start >= 0:
        return node_controls(env, start, positions)
    frame = t.second_frames[joint]
    if frame >= 0:
        return _pose_controls(poses[env, frame])
    return _world_controls()


@wp.kernel
def evaluate_rows_kernel(
    active: Envs,
    positions: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
    t: JointTable,
    references: wp.array2d(dtype=wp.float64),
    values: wp.array3d(dtype=wp.float64),
    derivatives: wp.array4d(dtype=wp.vec3d),
):
    """Rows of all joints; ``derivatives`` may be absent. Angles come nearest to ``references``."""
    place, joint, i = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    if t.present[env, joint] == 0:
        return
    w_a = t.first_weights[env % t.first_weights.shape[0], joint]
    w_b = t.second_weights[env % t.second_weights.shape[0], joint]
    a = w_a * node_controls(env, t.first_controls[joint], positions)
    b = w_b * second_controls(env, joint, t, positions, poses)
    kind = t.kinds[joint]
    row = joint_row(kind, a, b, t.sizes[joint], i)
    value = row.value
    if i == _COORDINATE and kind == REVOLUTE:
        value = unwrapped(value, references[env, joint])
    values[env, joint, i] = value
    if derivatives:
        by_first = wp.transpose(w_a) * row.a
        by_second = wp.transpose(w_b) * row.b
        for k in range(4):
            derivatives[env, joint, i, k] = matrix_row(by_first, k)
            derivatives[env, joint, i, k + 4] = matrix_row(by_second, k)


@wp.kernel
def begin_joints_kernel(
    mask: wp.array(dtype=wp.int32),
    values: wp.array3d(dtype=wp.float64),
    targets: wp.array2d(dtype=wp.float64),
    s: JointStep,
    start_multipliers: wp.array3d(dtype=wp.float64),
):
    """What a step goes by from its start on: where the coordinate, the last row of each joint, is
    then, the target of the drive, and the multipliers that a failed step goes back to."""
    env, joint = wp.tid()
    if mask[env] == 0:
        return
    s.starts[env, joint] = values[env, joint, _COORDINATE]
    s.targets[env, joint] = targets[env, joint]
    for i in range(_ROWS):
        start_multipliers[env, joint, i] = s.multipliers[env, joint, i]


@wp.func
def drive_of(env: int, joint: int, x: wp.float64, t: JointTable, s: JointStep) -> Response:
    """Response of the drive at coordinate x."""
    gains = t.gains[joint]
    target = s.targets[env, joint]
    rate = wp.float64(0.0)
    if t.follows_rate[joint] != 0:
        rate = target
    start = s.starts[env, joint]
    return drive_response(x, start, s.dts[env], gains[0], gains[1], gains[2], target, rate)


@wp.func
def constraint_of(
    env: int, joint: int, i: int, x: wp.float64, t: JointTable, s: JointStep
) -> Response:
    """Response of the constraint, or limit, of row i at value x."""
    multiplier = s.multipliers[env, joint, i]
    inverse = wp.float64(1.0) / (s.dts[env] * s.dts[env])
    k = t.penalties[joint][i // 3] * inverse
    if i < _COORDINATE:
        return equality_response(x, multiplier, k)
    limits = t.limits[joint]
    return bound_response(x, multiplier, k, limits[0], limits[1])


@wp.func
def response_of(
    env: int, joint: int, i: int, x: wp.float64, t: JointTable, s: JointStep
) -> Response:
    """Response of row i: constraint, and drive of the coordinate."""
    r = constraint_of(env, joint, i, x, t, s)
    if i == _COORDINATE:
        d = drive_of(env, joint, x, t, s)
        r.energy += d.energy
        r.slope += d.slope
        r.curvature += d.curvature
    return r


@wp.kernel
def joint_energy_kernel(
    active: Envs,
    values: wp.array3d(dtype=wp.float64),
    t: JointTable,
    s: JointStep,
    energies: wp.array2d(dtype=wp.float64),
):
    place, joint = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    if t.present[env, joint] == 0:
        return
    total = wp.float64(0.0)
    for i in range(_ROWS):
        total += response_of(env, joint, i, values[env, joint, i], t, s).energy
    energies[env, joint] = total


@wp.func
def _node_of(joint: int, k: int, t: JointTable) -> int:
    """Node of control vector k of a joint, -1 when it is prescribed."""
    if k < 4:
        return t.first_controls[joint] + k
    start = t.second_controls[joint]
    if start < 0:
        return -1
    return start + k - 4


@wp.kernel
def joint_gradient_kernel(
    active: Envs,
    group: wp.array(dtype=wp.int32),
    values: wp.array3d(dtype=wp.float64),
    derivatives: wp.array4d(dtype=wp.vec3d),
    t: JointTable,
    s: JointStep,
    gradient: wp.array2d(dtype=wp.vec3d),
):
    place, member, k = wp.tid()
    env = env_at(place, active)
    joint = group[member]
    node = _node_of(joint, k, t)
    if env < 0:
        return
    if t.present[env, joint] == 0 or node < 0:
        return
    total = wp.vec3d()
    for i in range(_ROWS):
        slope = response_of(env, joint, i, values[env, joint, i], t, s).slope
        total += slope * derivatives[env, joint, i, k]
    gradient[env, node] += total


@wp.kernel
def joint_hessian_kernel(
    active: Envs,
    group: wp.array(dtype=wp.int32),
    values: wp.array3d(dtype=wp.float64),
    derivatives: wp.array4d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
    goals: wp.array2d(dtype=wp.transformd),
    t: JointTable,
    s: JointStep,
    system: NewtonSystem,
):
    """Blocks (k, m) for all m; the motion of a kinematic frame goes to the right-hand side."""
    place, member, k = wp.tid()
    env = env_at(place, active)
    joint = group[member]
    node = _node_of(joint, k, t)
    if env < 0:
        return
    if t.present[env, joint] == 0 or node < 0:
        return
    frame = t.second_frames[joint]
    motion = mat43d()
    if frame >= 0:
        motion = _pose_controls(goals[env, frame]) - _pose_controls(poses[env, frame])
    # Held in a variable, so that Warp keeps the loop rolled.
    count = int(8)
    for m in range(count):
        block = wp.mat33d()
        for i in range(_ROWS):
            curvature = response_of(env, joint, i, values[env, joint, i], t, s).curvature
            along = curvature * derivatives[env, joint, i, k]
            block += wp.outer(along, derivatives[env, joint, i, m])
        other = _node_of(joint, m, t)
        if other >= 0:
            add_block(env, node, other, block, system)
        elif frame >= 0:
            row = system.free_index[node]
            system.rhs[env, row] = system.rhs[env, row] - block * matrix_row(motion, m - 4)


@wp.kernel
def joint_violation_kernel(
    active: wp.array(dtype=wp.int32),
    values: wp.array3d(dtype=wp.float64),
    t: JointTable,
    s: JointStep,
    violations: wp.array2d(dtype=wp.float64),
):
    """How far a joint is from its constraints [m], limits and the forces they may not have."""
    env, joint = wp.tid()
    violations[env, joint] = wp.float64(0.0)
    if active[env] == 0 or t.present[env, joint] == 0:
        return
    point = wp.vec3d(values[env, joint, 0], values[env, joint, 1], values[env, joint, 2])
    turn = wp.vec3d(values[env, joint, 3], values[env, joint, 4], values[env, joint, 5])
    i = _COORDINATE
    limit = constraint_of(env, joint, i, values[env, joint, i], t, s)
    change = wp.abs(limit.slope - s.multipliers[env, joint, i])
    over = change * s.dts[env] * s.dts[env] / t.penalties[joint][2]
    if t.kinds[joint] == REVOLUTE:
        over = over * t.sizes[joint]
    violations[env, joint] = wp.max(wp.length(point), wp.max(wp.length(turn), over))


@wp.kernel
def absorb_forces_kernel(
    which: wp.array(dtype=wp.int32),
    values: wp.array3d(dtype=wp.float64),
    t: JointTable,
    s: JointStep,
):
    """The forces of constraints and limits become their multipliers."""
    env, joint, i = wp.tid()
    if which[env] == 0 or t.present[env, joint] == 0:
        return
    x = values[env, joint, i]
    s.multipliers[env, joint, i] = constraint_of(env, joint, i, x, t, s).slope


@wp.kernel
def joint_outputs_kernel(
    which: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    values: wp.array3d(dtype=wp.float64),
    derivatives: wp.array4d(dtype=wp.vec3d),
    t: JointTable,
    s: JointStep,
    coordinates: wp.array2d(dtype=wp.float64),
    rates: wp.array2d(dtype=wp.float64),
    efforts: wp.array2d(dtype=wp.float64),
    forces: wp.array2d(dtype=wp.vec3d),
    torques: wp.array2d(dtype=wp.vec3d),
):
    """Coordinate, its rate, effort of the drive, and the wrench on the first body at its anchor."""
    env, joint = wp.tid()
    if which[env] == 0 or t.present[env, joint] == 0:
        return
    x = values[env, joint, _COORDINATE]
    coordinates[env, joint] = x
    rates[env, joint] = (x - s.starts[env, joint]) / s.dts[env]
    efforts[env, joint] = -drive_of(env, joint, x, t, s).slope
    y = node_controls(env, t.first_controls[joint], positions)
    w_a = t.first_weights[env % t.first_weights.shape[0], joint]
    anchor = matrix_row(w_a * y, 0)
    force = wp.vec3d()
    torque = wp.vec3d()
    for k in range(4):
        pull = wp.vec3d()
        for i in range(_ROWS):
            slope = response_of(env, joint, i, values[env, joint, i], t, s).slope
            pull -= slope * derivatives[env, joint, i, k]
        arm = matrix_row(y, k)
        if k == 0:
            force = pull
            arm = arm - anchor
        torque += wp.cross(arm, pull)
    forces[env, joint] = force
    torques[env, joint] = torque


@wp.kernel
def largest_violation_kernel(
    active: wp.array(dtype=wp.int32),
    joint_violations: wp.array2d(dtype=wp.float64),
    tolerance: wp.float64,
    violations: wp.array(dtype=wp.float64),
    violated: wp.array(dtype=wp.int32),
):
    """Largest violation of an environment [m], and whether it is more than the tolerance."""
    env = wp.tid()
    violated[env] = 0
    if active[env] == 0:
        return
    worst = wp.float64(0.0)
    for joint in range(joint_violations.shape[1]):
        worst = wp.max(worst, joint_violations[env, joint])
    violations[env] = worst
    if worst > tolerance:
        violated[env] = 1


@wp.kernel
def joint_rounding_kernel(
    mask: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    first: int,
    count: int,
    t: JointTable,
    s: JointStep,
    forces: wp.array(dtype=wp.float64),
    energies: wp.array(dtype=wp.float64),
):
    """Force [N] that the last digit of the positions makes in the penalties, and energy [J] that it
    makes with the multipliers."""
    env = wp.tid()
    if mask[env] == 0:
        return
    reach = wp.float64(0.0)
    for node in range(first, first + count):
        x = positions[env, node]
        reach = wp.max(reach, wp.max(wp.abs(x[0]), wp.max(wp.abs(x[1]), wp.abs(x[2]))))
    square = wp.float64(0.0)
    energy = wp.float64(0.0)
    for joint in range(t.sizes.shape[0]):
        force = t.penalties[joint][0] * reach + t.penalties[joint][1] * t.sizes[joint]
        square += force * force
        for i in range(_ROWS):
            energy += wp.abs(s.multipliers[env, joint, i])
    forces[env] = _EPSILON * wp.sqrt(square) / (s.dts[env] * s.dts[env])
    energies[env] = wp.float64(4.0) * _EPSILON * reach * energy
