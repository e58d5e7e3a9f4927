# SPDX-License-Identifier: Apache-2.0
"""Newton's steps of affine bodies, bent to follow the rotations.

A straight step dA of a body's map A that turns it by an angle w stretches it by w^2 / 2, which a
body of 1 GPa resists so much that every other Newton iteration only undoes the stretch of the last
one. Split into dA A^-1 = W + S, skew and symmetric, the step exp(W) (I + S) A is the same to first
order and strains by S alone.

A body with joints follows the screw of the twist (W, dy0): its centre goes V(W) dy0 with V the left
Jacobian of the rotations [Murray, Li and Sastry 1994, A Mathematical Introduction to Robotic
Manipulation, section 2.3.3], and what turns about a hinge keeps it. Any other body turns about its
pivot, the mean of its contact points weighted with their forces, or about its centre where nothing
touches it, while the pivot goes straight: with r from centre to pivot the centre goes
dy0 + W r - V(W) W r. (On the screw, a plate that fell on a floor with 8 m/s and slid by 15 of its
lengths in the step while it turned lifted off or sank by the product of both, and of each Newton
step a two-thousandth was taken.)
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.affine.rigidity import body_map
from taccel_lab.ipc.device.sums import BLOCK_THREADS, block_total
from taccel_lab.ipc.motion.trial import Trial, put_node, straight
from taccel_lab.model import Model
from taccel_lab.model.embedding import Embedded, embedded, embedded_count, embedded_node
from taccel_lab.model.env_lists import EnvMask, Envs, env_at, place_count
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch, launch_blocks

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})

LARGEST_TURN = 0.1
"""Angle that one step may turn a body by [rad]: everything that a bent step may meet is a candidate
for contact, and it leads off the straight one by the square of the angle."""
SMALLEST_TURN = 1e-5
"""Angle below which steps stay straight [rad]: they strain by 5e-11."""


@wp.func
def twist_of(change: wp.mat33d) -> wp.vec3d:
    """Axial vector of the skew part of dA A^-1 [rad]."""
    half = wp.float64(0.5)
    return half * wp.vec3d(
        change[2, 1] - change[1, 2], change[0, 2] - change[2, 0], change[1, 0] - change[0, 1]
    )


@wp.func
def bent_map(a: wp.mat33d, change: wp.mat33d) -> wp.mat33d:
    """exp(W) (I + S) A for dA A^-1 = W + S of less than half a turn."""
    w = twist_of(change)
    angle = wp.max(wp.length(w), wp.float64(1.0e-12))
    skew = wp.skew(w)
    stretch = wp.float64(0.5) * (change + wp.transpose(change))
    sine = wp.sin(angle) / angle
    cosine = wp.float64(2.0) * wp.pow(wp.sin(wp.float64(0.5) * angle) / angle, wp.float64(2.0))
    rotation = wp.identity(n=3, dtype=wp.float64) + sine * skew + cosine * (skew * skew)
    return rotation * (a + stretch * a)


@wp.func
def bent_displacement(displacement: wp.vec3d, twist: wp.vec3d) -> wp.vec3d:
    """Way of the centre along the screw, V(W) way [m]."""
    angle = wp.max(wp.length(twist), wp.float64(1.0e-12))
    sine = wp.sin(angle) / angle
    cosine = wp.float64(2.0) * wp.pow(wp.sin(wp.float64(0.5) * angle) / angle, wp.float64(2.0))
    # (angle - sin angle) / angle^3, without cancellation where it is small.
    third = wp.float64(1.0) / wp.float64(6.0) - angle * angle / wp.float64(120.0)
    if angle > wp.float64(1.0e-2):
        third = (wp.float64(1.0) - sine) / (angle * angle)
    once = wp.cross(twist, displacement)
    return displacement + cosine * once + third * wp.cross(twist, once)


@wp.kernel
def _pivot_kernel(
    active: Envs,
    control_starts: wp.array(dtype=wp.int32),
    vertex_starts: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    contact_gradient: wp.array2d(dtype=wp.vec3d),
    pivots: wp.array2d(dtype=wp.vec3d),
):
    place, body, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    centre = positions[env, control_starts[body]]
    arm = wp.vec3d()
    force = wp.float64(0.0)
    for i in range(vertex_starts[body] + lane, vertex_starts[body + 1], wp.block_dim()):
        weight = wp.length(contact_gradient[env, i])
        force += weight
        arm += weight * (positions[env, i] - centre)
    total = block_total(force)
    x = block_total(arm[0])
    y = block_total(arm[1])
    z = block_total(arm[2])
    if lane == 0:
        # Where nothing touches the sums are zero.
        pivots[env, body] = wp.vec3d(x, y, z) / wp.max(total, wp.float64(1.0e-300))


@wp.func
def turning_displacement(
    displacement: wp.vec3d, twist: wp.vec3d, pivot: wp.vec3d, has_joint: wp.int32
) -> wp.vec3d:
    """Part of the centre's way that comes of turning [m]: all of it for a body with joints."""
    if has_joint != 0:
        return displacement
    return wp.cross(pivot, twist)


@wp.kernel
def _measure_kernel(
    active: Envs,
    control_starts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=wp.float64),
    have_joints: wp.array(dtype=wp.int32),
    pivots: wp.array2d(dtype=wp.vec3d),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    smallest: wp.float64,
    turns: wp.array(dtype=wp.float64),
    reaches: wp.array(dtype=wp.float64),
):
    """Largest turn of a body [rad]; where steps are bent, what a vertex may leave its straight way
    by [m] comes on top of ``reaches``.

    The length L of a body is the largest distance of a vertex from its centre.
    """
    place = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    largest = wp.float64(0.0)
    deviation = wp.float64(0.0)
    for body in range(control_starts.shape[0]):
        start = control_starts[body]
        change = body_map(env, start, lengths[body], displacements)
        change = change * wp.inverse(body_map(env, start, lengths[body], positions))
        size = wp.sqrt(wp.ddot(change, change))
        turn = wp.length(twist_of(change))
        # |exp(W)(I + S) - I - W - S| <= w^2/2 + w |S|; |V(W) - I| <= w/2.
        # Of the largest part of the step that may be taken.
        part = wp.min(wp.float64(1.0), wp.float64(LARGEST_TURN) / wp.max(turn, wp.float64(1.0e-12)))
        bent = turn * size * lengths[body]
        displacement = displacements[env, start]
        displacement = turning_displacement(
            displacement, twist_of(change), pivots[env, body], have_joints[body]
        )
        bent += wp.float64(0.5) * turn * wp.length(displacement)
        bent = part * part * bent
        largest = wp.max(largest, turn)
        deviation = wp.max(deviation, bent)
    turns[env] = largest
    if largest > smallest:
        reaches[env] += deviation


@wp.func
def bent_controls(
    env: int,
    start: int,
    length: wp.float64,
    pivot: wp.vec3d,
    has_joint: wp.int32,
    t: Trial,
):
    """Control nodes [m] of a body at the end of the bent step: its centre, and the columns of its
    map times its length."""
    fraction = t.fractions[env]
    a = body_map(env, start, length, t.positions)
    change = fraction * (body_map(env, start, length, t.displacements) * wp.inverse(a))
    turned = length * bent_map(a, change)
    twist = twist_of(change)
    displacement = fraction * t.displacements[env, start]
    turning = turning_displacement(displacement, twist, pivot, has_joint)
    centre = t.positions[env, start] + (displacement - turning) + bent_displacement(turning, twist)
    return centre, turned


@wp.kernel
def _place_affine_kernel(
    active: Envs,
    turns: wp.array(dtype=wp.float64),
    smallest: wp.float64,
    lanes: int,
    control_starts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=wp.float64),
    have_joints: wp.array(dtype=wp.int32),
    pivots: wp.array2d(dtype=wp.vec3d),
    e: Embedded,
    t: Trial,
):
    """Each thread finds the control nodes itself, for the nodes that it places."""
    place, body, lane = wp.tid()
    env = env_at(place, active)
    count = embedded_count(body, e)
    if env < 0 or (lane > 0 and lane >= count):
        return
    start = control_starts[body]
    y0 = straight(env, start, t)
    y1 = straight(env, start + 1, t)
    y2 = straight(env, start + 2, t)
    y3 = straight(env, start + 3, t)
    if turns[env] > smallest:
        centre, turned = bent_controls(
            env, start, lengths[body], pivots[env, body], have_joints[body], t
        )
        y0 = centre
        y1 = wp.vec3d(turned[0, 0], turned[1, 0], turned[2, 0])
        y2 = wp.vec3d(turned[0, 1], turned[1, 1], turned[2, 1])
        y3 = wp.vec3d(turned[0, 2], turned[1, 2], turned[2, 2])
    if lane == 0:
        put_node(env, start, y0, t)
        put_node(env, start + 1, y1, t)
        put_node(env, start + 2, y2, t)
        put_node(env, start + 3, y3, t)
    for i in range(lane, count, lanes):
        node = embedded_node(body, i, e)
        w = e.weights[node]
        put_node(env, node, w[0] * y0 + w[1] * y1 + w[2] * y2 + w[3] * y3, t)


def find_pivots(
    model: Model,
    active: EnvMask,
    positions: wp.array,
    contact_gradient: wp.array,
    pivots: wp.array,
) -> None:
    """Set ``pivots`` [m], vec3d, [env_count, affine_count]: from the centre of each body to the
    mean of its contact points, weighted with their forces; zero where nothing touches it."""
    affine = model.affine
    inputs = [active, affine.control_starts, affine.vertex_starts, positions, contact_gradient]
    launch_blocks(_pivot_kernel, (model.env_count, affine.count), *inputs, pivots)


def measure_turns(
    model: Model,
    active: EnvMask,
    pivots: wp.array,
    positions: wp.array,
    displacements: wp.array,
    turns: wp.array,
    reaches: wp.array,
) -> None:
    """Largest turn [rad] of a body along ``displacements``, in the environments of ``active``;
    where it exceeds SMALLEST_TURN, a bound of how far any vertex of a bent step leaves the straight
    one is added to ``reaches`` [m]. Both float64, [env_count]."""
    affine = model.affine
    inputs = [active, affine.control_starts, affine.lengths, affine.have_joints, pivots, positions]
    launch(_measure_kernel, model.env_count, *inputs, displacements, SMALLEST_TURN, turns, reaches)


def place_affine(
    model: Model, active: EnvMask, turns: wp.array, pivots: wp.array, trial: Trial
) -> None:
    """Put the nodes of affine bodies where ``trial`` leads, in the environments of ``active``; on
    the bent step where ``turns`` [rad], [env_count], exceed SMALLEST_TURN."""
    affine = model.affine
    first = len(model.scene.soft_bodies)
    ranges = [body.nodes for body in model.bodies[first : first + affine.count]]
    most = max(end - start for start, end in ranges) + len(affine.carried)
    lanes = lane_count(model.device, place_count(active), most)
    inputs = [active, turns, SMALLEST_TURN, lanes, affine.control_starts, affine.lengths]
    inputs += [affine.have_joints, pivots, embedded(model), trial]
    launch(_place_affine_kernel, (model.env_count, affine.count, lanes), *inputs)
