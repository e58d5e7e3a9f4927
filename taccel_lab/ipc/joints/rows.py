# SPDX-License-Identifier: Apache-2.0
"""The scalar rows of a joint, and the energy of each.

The seven scalar rows of a joint and their derivatives in the frames of its two bodies.

A body carries a frame: a point p and three directions t (the axis), u, v, all of them weighted sums
of its control nodes, and so linear in the unknowns. With subscripts a and b for the two bodies and
d = p_a - p_b the rows are

    0..2  point [m]      d                       prismatic: u_b . d, v_b . d, 0
    3..5  turn [m]       l t_a x t_b             fixed, prismatic: l/2 sum over t, u, v of r_a x r_b
    6     coordinate     atan2(v_b.u_a - u_b.v_a, u_b.u_a + v_b.v_a) [rad]; prismatic: t_b . d [m]

Rows 0..5 are to vanish; l is a size of the bodies, which makes the second three the way [m] that a
turn moves them. All rows are built of scalar and vector products of the frames, and so are the same
for the whole joint moved rigidly: they cannot change its momenta. None but the turn's sees strain,
so a joint does not stiffen its bodies. (Linear rows, as in Lan et al. 2022, sec. 6, tie the strains
of both bodies too, which needs penalties as stiff as the bodies are.)

Energy of one row of a joint: an augmented Lagrangian for constraints and limits, and drives.

A constraint g = 0 has the energy lambda g + k/2 g^2, with a multiplier that becomes lambda + k g
once the step has converged; bounds low <= x <= high have k/2 e^2 - lambda^2 / (2 k) with the part
e of x + lambda / k that lies outside of them [Nocedal and Wright 2006, Numerical Optimization,
sec. 17.3 and 17.4; Rockafellar 1973]. The latter has no second derivative where a limit begins to
act, and no stiffness but k: it is the same for a limit that holds a tonne.

A drive is the potential of the implicit step of effort = -stiffness (x - target)
- damping ((x - x_n) / dt - rate): a spring K/2 (x - x_eq)^2 which saturates at the largest effort.
"""

from __future__ import annotations

import math

import warp as wp

from taccel_lab.ipc.device.matrices import mat43d

wp.set_module_options({"enable_backward": False})

COORDINATE_ROW = 6
FIXED = wp.constant(0)
REVOLUTE = wp.constant(1)
PRISMATIC = wp.constant(2)
_TURN = wp.constant(wp.float64(2.0 * math.pi))


@wp.struct
class JointRow:
    """One scalar and its derivatives; rows of ``a`` and ``b``: point, t, u, v."""

    value: wp.float64
    a: mat43d
    b: mat43d


@wp.func
def matrix_row(m: mat43d, i: int) -> wp.vec3d:
    """Row i: the point (0) or a direction of a frame."""
    return wp.vec3d(m[i, 0], m[i, 1], m[i, 2])


@wp.func
def with_row(m: mat43d, i: int, value: wp.vec3d) -> mat43d:
    """The matrix with row i replaced."""
    result = m
    for k in range(3):
        result[i, k] = value[k]
    return result


@wp.func
def unit_axis(i: int) -> wp.vec3d:
    """World axis i."""
    result = wp.vec3d()
    result[i] = wp.float64(1.0)
    return result


@wp.func
def coincidence_row(a: mat43d, b: mat43d, i: int) -> JointRow:
    """Component i of d."""
    row = JointRow()
    axis = unit_axis(i)
    row.value = wp.dot(axis, matrix_row(a, 0) - matrix_row(b, 0))
    row.a = with_row(row.a, 0, axis)
    row.b = with_row(row.b, 0, -axis)
    return row


@wp.func
def slide_row(a: mat43d, b: mat43d, direction: int) -> JointRow:
    """d along a direction of frame b (1: t, 2: u, 3: v)."""
    row = JointRow()
    d = matrix_row(a, 0) - matrix_row(b, 0)
    along = matrix_row(b, direction)
    row.value = wp.dot(along, d)
    row.a = with_row(row.a, 0, along)
    row.b = with_row(with_row(row.b, 0, -along), direction, d)
    return row


@wp.func
def turn_row(a: mat43d, b: mat43d, i: int, directions: int, scale: wp.float64) -> JointRow:
    """Component i of scale * sum r_a x r_b over the first ``directions`` of t, u, v."""
    row = JointRow()
    axis = unit_axis(i)
    for k in range(1, directions + 1):
        r_a = matrix_row(a, k)
        r_b = matrix_row(b, k)
        row.value += scale * wp.dot(axis, wp.cross(r_a, r_b))
        row.a = with_row(row.a, k, scale * wp.cross(r_b, axis))
        row.b = with_row(row.b, k, scale * wp.cross(axis, r_a))
    return row


@wp.func
def angle_row(a: mat43d, b: mat43d) -> JointRow:
    """Angle of frame a about the axis, seen from frame b, in (-pi, pi]."""
    row = JointRow()
    u_a = matrix_row(a, 2)
    v_a = matrix_row(a, 3)
    u_b = matrix_row(b, 2)
    v_b = matrix_row(b, 3)
    sine = wp.dot(v_b, u_a) - wp.dot(u_b, v_a)
    cosine = wp.dot(u_b, u_a) + wp.dot(v_b, v_a)
    row.value = wp.atan2(sine, cosine)
    scale = wp.float64(1.0) / (sine * sine + cosine * cosine)
    s = sine * scale
    c = cosine * scale
    row.a = with_row(row.a, 2, c * v_b - s * u_b)
    row.a = with_row(row.a, 3, -c * u_b - s * v_b)
    row.b = with_row(row.b, 2, -c * v_a - s * u_a)
    row.b = with_row(row.b, 3, c * u_a - s * v_a)
    return row


@wp.func
def joint_row(kind: int, a: mat43d, b: mat43d, size: wp.float64, i: int) -> JointRow:
    """Row i of a joint; zero where the kind has none."""
    row = JointRow()
    if i < 3:
        if kind != PRISMATIC:
            row = coincidence_row(a, b, i)
        elif i < 2:
            row = slide_row(a, b, 2 + i)
    elif i < 6:
        directions = int(1)
        scale = size
        if kind != REVOLUTE:
            directions = int(3)
            scale = wp.float64(0.5) * size
        row = turn_row(a, b, i - 3, directions, scale)
    elif kind == REVOLUTE:
        row = angle_row(a, b)
    elif kind == PRISMATIC:
        row = slide_row(a, b, 1)
    return row


@wp.func
def unwrapped(angle: wp.float64, reference: wp.float64) -> wp.float64:
    """The angle plus the whole turns that bring it nearest to ``reference``."""
    return angle + _TURN * wp.round((reference - angle) / _TURN)


@wp.struct
class Response:
    """Energy [J] of a row of value x, dE/dx and a bound of d2E/dx2 that is never negative."""

    energy: wp.float64
    slope: wp.float64
    curvature: wp.float64


@wp.func
def equality_response(x: wp.float64, multiplier: wp.float64, k: wp.float64) -> Response:
    """Augmented Lagrangian of x = 0."""
    r = Response()
    r.energy = x * (multiplier + wp.float64(0.5) * k * x)
    r.slope = multiplier + k * x
    r.curvature = k
    return r


@wp.func
def bound_response(
    x: wp.float64, multiplier: wp.float64, k: wp.float64, low: wp.float64, high: wp.float64
) -> Response:
    """Augmented Lagrangian of low <= x <= high; the multiplier is positive at ``high``."""
    r = Response()
    half = wp.float64(0.5)
    shifted = x + multiplier / k
    outside = shifted - wp.clamp(shifted, low, high)
    r.energy = half * k * outside * outside - half * multiplier * multiplier / k
    r.slope = k * outside
    if outside != wp.float64(0.0):
        r.curvature = k
    return r


@wp.func
def drive_response(
    x: wp.float64,
    start: wp.float64,
    dt: wp.float64,
    stiffness: wp.float64,
    damping: wp.float64,
    max_effort: wp.float64,
    target: wp.float64,
    rate: wp.float64,
) -> Response:
    """Potential of a drive from coordinate ``start`` towards ``target`` and ``rate``."""
    r = Response()
    half = wp.float64(0.5)
    k = stiffness + damping / dt
    if k == wp.float64(0.0):
        return r
    e = x - (stiffness * target + damping * (start / dt + rate)) / k
    if k * wp.abs(e) <= max_effort:
        r.energy = half * k * e * e
        r.slope = k * e
        r.curvature = k
    else:
        r.energy = max_effort * (wp.abs(e) - half * max_effort / k)
        r.slope = max_effort * wp.sign(e)
    return r
