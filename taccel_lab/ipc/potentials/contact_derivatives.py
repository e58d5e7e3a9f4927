# SPDX-License-Identifier: Apache-2.0
"""How the forces of each collision change with all that they depend on, exactly.

A step has converged when the forces balance with friction frozen where the step ends, so that the
friction of a result depends on its own contacts: through their normal force, normal and weights,
and through the sliding since the start of the step. What is differentiated here is that force,

    f_i = w_i mu lambda(x) f1(|u|) / |u| u,   u = (I - n n^T)(sum_i w_i (x_i - before_i) - m_n),

in which lambda, w, n and the normal motion m_n (``contact.friction``) depend on the positions. Its
derivative is not symmetric: sliding pulls across what pressing stiffens.

Closest points slide by s_a = -(t_a . dr + d n . sum_j c_aj dx_j) along the free tangents of a pair
(``distance.derivatives``, with dr = sum_j w_j dx_j), which makes dw_i = sum_a s_a c_ai and
dn = (I - n n^T)(dr + sum_a s_a t_a) / d. Own derivation; the barrier's part is its exact Hessian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.ipc.contact.barrier import (
    contact_potential,
    contact_potential_d1,
    contact_potential_d2,
)
from taccel_lab.ipc.contact.collision_lists import (
    CollisionLists,
    ContactGeometry,
    closest_pair,
    collision_gap,
)
from taccel_lab.ipc.contact.collisions import Collisions
from taccel_lab.ipc.contact.friction import (
    friction_f1_over_u,
    friction_f2,
    normal_motion,
    normal_motion_change,
    tangential,
    way_in,
)
from taccel_lab.ipc.contact.pair_energy import (
    GAUSS_NEWTON,
    mollified_gradient,
    mollifier_block,
    mollifier_coefficients,
    mollifier_terms,
    pair_gradient,
    pair_hessian,
    pair_hessian_block,
)
from taccel_lab.ipc.device.matrices import mat43d
from taccel_lab.ipc.device.ragged_lists import list_end
from taccel_lab.ipc.distance.closest_pairs import ClosestPair, combine, plane_parameters
from taccel_lab.ipc.distance.derivatives import outer_rows, pair_frame, pair_normal
from taccel_lab.ipc.distance.edge_edge_mollifier import (
    edge_edge_cross_sq,
    edge_edge_cross_sq_gradient,
    edge_edge_mollifier,
    edge_edge_mollifier_d1,
)
from taccel_lab.ipc.elasticity.principal import PSD_NONE
from taccel_lab.ipc.potentials.contact import contact_rows, is_mollified
from taccel_lab.ipc.potentials.friction import StepMotion
from taccel_lab.model import Model
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})

NOW, BEFORE, TURN_NOW, TURN_BEFORE = slice(0, 12), slice(12, 24), slice(24, 27), slice(27, 30)
"""Columns of slopes: by the positions of the four nodes at the end and at the start of the step
[N/m], by small turns of a ball about the world's axes at both [N/rad] ..."""
THRESHOLD, INSET, RANGE = 30, 31, 32
"""... and by the numbers of the collision: of the mollifier [N/m^4], of a ball's inset and of the
range [N/m]. In the stiffness forces are linear."""
_COLUMNS = 33
_BORDER = wp.constant(wp.float64(1e-9))
"""Part of a face or edge by which a node may be off its border and still counts as over it."""


@wp.struct
class Change:
    """Small changes: of the positions now and at the start of the step [m], row i for node i; turns
    of a ball at both [rad]; of the numbers of the collision."""

    now: mat43d
    before: mat43d
    turn_now: wp.vec3d
    turn_before: wp.vec3d
    threshold: wp.float64
    inset: wp.float64
    reach: wp.float64


@wp.struct
class PairChange:
    """What a small motion makes of a pair: of its distance [m], unit normal and weights."""

    distance: wp.float64
    normal: wp.vec3d
    weights: wp.vec4d


@wp.struct
class Rubbing:
    """Force of friction on the nodes for a coefficient of one [N], and how it changes."""

    rows: mat43d
    change: mat43d


@wp.func
def _combined(weights: wp.vec4d, rows: mat43d) -> wp.vec3d:
    return combine(weights, rows[0], rows[1], rows[2], rows[3])


@wp.func
def _nodes_at(env: int, nodes: wp.vec4i, positions: wp.array2d(dtype=wp.vec3d)) -> mat43d:
    return wp.matrix_from_rows(
        positions[env, nodes[0]],
        positions[env, nodes[1]],
        positions[env, nodes[2]],
        positions[env, nodes[3]],
    )


@wp.func
def pair_change(kind: int, pair: ClosestPair, x: mat43d, moved: mat43d) -> PairChange:
    """Change of a pair at the positions ``x`` whose nodes move by ``moved`` [m]."""
    c = PairChange()
    n = pair_normal(pair)
    relative = _combined(pair.weights, moved)
    c.distance = wp.dot(n, relative)
    # The normal of a plane stays, whatever the distance is.
    if kind != 4:
        frame = pair_frame(pair, x[0], x[1], x[2], x[3])
        distance = wp.sqrt(pair.distance_sq)
        if pair.free_count > 0:
            t = wp.vec3d(frame.axes[0, 1], frame.axes[1, 1], frame.axes[2, 1])
            slid = -(wp.dot(t, relative) + distance * wp.dot(n, _combined(frame.slide_1, moved)))
            c.weights += slid * frame.slide_1
            relative += slid * t
        if pair.free_count > 1:
            t = wp.vec3d(frame.axes[0, 2], frame.axes[1, 2], frame.axes[2, 2])
            slid = -(wp.dot(t, relative) + distance * wp.dot(n, _combined(frame.slide_2, moved)))
            c.weights += slid * frame.slide_2
            relative += slid * t
        c.normal = tangential(n, relative) / distance
    return c


@wp.func
def over_a_border(kind: int, x: mat43d) -> bool:
    """Whether a node is right over the border of a face, or the end of an edge, whose normal it
    would have on one side of it and not on the other."""
    least = wp.float64(1.0)
    if kind == 0:
        inner = plane_parameters(x[2] - x[1], x[3] - x[1], x[0] - x[1])
        least = wp.min(wp.min(inner[0], inner[1]), wp.float64(1.0) - inner[0] - inner[1])
    if kind == 1:
        edge = x[2] - x[1]
        t = wp.dot(x[0] - x[1], edge) / wp.length_sq(edge)
        least = wp.min(t, wp.float64(1.0) - t)
    return wp.abs(least) < _BORDER


@wp.func
def rubbing(
    env: int,
    at: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    motion: StepMotion,
    eps_u: wp.float64,
    by: Change,
) -> Rubbing:
    """Friction of one collision and how it changes; see the module."""
    nodes = lists.stencils[at]
    kind = lists.kinds[at]
    k = lists.stiffnesses[at]
    reach = lists.ranges[at]
    threshold = lists.thresholds[at]
    x = _nodes_at(env, nodes, motion.positions)
    pair = closest_pair(env, kind, nodes, motion.positions, geometry)
    c = pair_change(kind, pair, x, by.now)
    gap = collision_gap(pair, nodes, lists.insets[at], geometry)
    e1 = contact_potential_d1(gap, reach, k)
    e2 = contact_potential_d2(gap, reach, k)
    pressed = -e1
    more = -e2 * (c.distance + by.inset - gap / reach * by.reach)
    if threshold > wp.float64(0.0):
        cross_sq = edge_edge_cross_sq(x[0], x[1], x[2], x[3])
        m = edge_edge_mollifier(cross_sq, threshold)
        m1 = edge_edge_mollifier_d1(cross_sq, threshold)
        turned = wp.ddot(edge_edge_cross_sq_gradient(x[0], x[1], x[2], x[3]), by.now)
        more = m * more - e1 * m1 * (turned - cross_sq / threshold * by.threshold)
        pressed = m * pressed
    n = pair_normal(pair)
    since = x - _nodes_at(env, nodes, motion.previous)
    u = _combined(pair.weights, since)
    du = _combined(c.weights, since) + _combined(pair.weights, by.now - by.before)
    if motion.node_is_ball[nodes[0]] != 0:
        body = motion.node_bodies[nodes[0]] - motion.first_kinematic
        turn = wp.transform_get_rotation(motion.poses[env, body]) * wp.quat_inverse(
            wp.transform_get_rotation(motion.previous_poses[env, body])
        )
        radius = motion.node_radii[nodes[0]]
        arm = -radius * n
        longer = -radius * c.normal
        back = wp.quat_rotate_inv(turn, arm)
        u += arm - back
        du += longer - wp.quat_rotate_inv(turn, longer - wp.cross(by.turn_now, arm))
        du -= wp.cross(by.turn_before, back)
    else:
        old = closest_pair(env, kind, nodes, motion.previous, geometry)
        then = _nodes_at(env, nodes, motion.previous)
        old_change = pair_change(kind, old, then, by.before)
        way = way_in(env, kind, nodes, pair, motion.positions, motion.previous, geometry)
        along = wp.dot(du, n) + wp.dot(u, c.normal)
        u -= normal_motion(way, n)
        du -= normal_motion_change(way, n, along, c.distance, c.normal, old_change.normal)
    across = tangential(n, u)
    dacross = tangential(n, du) - wp.dot(n, u) * c.normal - wp.dot(c.normal, u) * n
    size = wp.length(across)
    over = friction_f1_over_u(size, eps_u)
    direction = wp.normalize(across)
    bend = (friction_f2(size, eps_u) - over) * wp.dot(direction, dacross)
    result = Rubbing()
    force = pressed * over * across
    result.rows = outer_rows(pair.weights, force)
    result.change = outer_rows(c.weights, force)
    dforce = more * over * across + pressed * (over * dacross + bend * direction)
    result.change += outer_rows(pair.weights, dforce)
    return result


@wp.func
def barrier_change(
    env: int,
    at: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    by: Change,
) -> mat43d:
    """Change of the barrier's gradient [N], row i for node i; not by what was before."""
    nodes = lists.stencils[at]
    kind = lists.kinds[at]
    k = lists.stiffnesses[at]
    reach = lists.ranges[at]
    threshold = lists.thresholds[at]
    x = _nodes_at(env, nodes, positions)
    pair = closest_pair(env, kind, nodes, positions, geometry)
    d = collision_gap(pair, nodes, lists.insets[at], geometry)
    e0 = contact_potential(d, reach, k)
    e1 = contact_potential_d1(d, reach, k)
    e2 = contact_potential_d2(d, reach, k)
    scale = wp.float64(1.0)
    mollified = is_mollified(env, nodes, threshold, positions)
    if mollified:
        scale = edge_edge_mollifier(edge_edge_cross_sq(x[0], x[1], x[2], x[3]), threshold)
    mode = int(PSD_NONE)
    if kind == 4:
        mode = wp.static(GAUSS_NEWTON)
    h = pair_hessian(pair, x[0], x[1], x[2], x[3], scale * e1, scale * e2, mode)
    # By the inset and by the range, at the same positions.
    e0_more = e1 * by.inset + (e0 - d * e1) / reach * by.reach
    e1_more = e2 * (by.inset - d / reach * by.reach)
    rows = pair_gradient(pair, scale * e1_more)
    size = int(4)
    for i in range(size):
        for j in range(size):
            rows[i] = rows[i] + pair_hessian_block(h, i, j) * by.now[j]
    if mollified:
        terms = mollifier_terms(pair, x[0], x[1], x[2], x[3], threshold, e0, e1, PSD_NONE)
        for i in range(size):
            a = mollifier_coefficients(pair.weights, i)
            for j in range(size):
                b = mollifier_coefficients(pair.weights, j)
                rows[i] = rows[i] + mollifier_block(terms, a, b) * by.now[j]
        # The part of the mollifier's own slope, and both by the threshold: m = y (2 - y).
        y = edge_edge_cross_sq(x[0], x[1], x[2], x[3]) / threshold
        rows += mollified_gradient(
            pair, x[0], x[1], x[2], x[3], threshold, e0_more, wp.float64(0.0)
        )
        two = wp.float64(2.0)
        ratio = by.threshold / threshold
        rows += pair_gradient(pair, two * (y - wp.float64(1.0)) * y * ratio * e1)
        bent = two * (two * y - wp.float64(1.0)) / threshold * ratio * e0
        rows += bent * edge_edge_cross_sq_gradient(x[0], x[1], x[2], x[3])
    return rows


@wp.kernel
def _slopes_kernel(
    env: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    pair_friction: wp.array3d(dtype=wp.float64),
    motion: StepMotion,
    eps_u: wp.array(dtype=wp.float64),
    # Out
    forces: wp.array(dtype=mat43d),
    per_friction: wp.array(dtype=mat43d),
    columns: wp.array2d(dtype=mat43d),
    kinks: wp.array(dtype=wp.int32),
):
    entry, column = wp.tid()
    at = lists.room.starts[env] + entry
    if at >= list_end(env, lists.room):
        return
    nodes = lists.stencils[at]
    first = geometry.node_bodies[nodes[0]]
    second = geometry.node_bodies[nodes[3]]
    one = wp.float64(1.0)
    by = Change()
    if column < 12:
        by.now[column / 3, column % 3] = one
    elif column < 24:
        by.before[(column - 12) / 3, column % 3] = one
    elif column < 27:
        by.turn_now[column - 24] = one
    elif column < 30:
        by.turn_before[column - 27] = one
    elif column == 30:
        by.threshold = one
    elif column == 31:
        by.inset = one
    else:
        by.reach = one
    change = barrier_change(env, at, lists, geometry, motion.positions, by)
    friction = Rubbing()
    if pair_friction:
        mu = pair_friction[env % pair_friction.shape[0], first, second]
        friction = rubbing(env, at, lists, geometry, motion, eps_u[env], by)
        change += mu * friction.change
    columns[entry, column] = change
    if column == 0:
        pair = closest_pair(env, lists.kinds[at], nodes, motion.positions, geometry)
        rows = contact_rows(env, at, pair, lists, geometry, motion.positions)
        if pair_friction:
            rows += pair_friction[env % pair_friction.shape[0], first, second] * friction.rows
            per_friction[entry] = friction.rows
            if motion.node_is_ball[nodes[0]] == 0:
                then = _nodes_at(env, nodes, motion.previous)
                kinks[entry] = int(over_a_border(lists.kinds[at], then))
        forces[entry] = rows


@dataclass(frozen=True)
class ContactDerivatives:
    """Collisions of one environment; forces are gradients, what acts on a node is the negative."""

    nodes: np.ndarray
    """Stencil, int32, shape [collision, 4]; entries that a kind does not need repeat the last."""
    kinds: np.ndarray
    """int32, shape [collision]."""
    stiffnesses: np.ndarray
    """Stiffness of each collision [N], in which its forces are linear, shape [collision]."""
    bodies: np.ndarray
    """The two bodies, int32, shape [collision, 2]."""
    forces: np.ndarray
    """Forces on the four nodes, of barrier and friction [N], shape [collision, 4, 3]."""
    per_friction: np.ndarray
    """d ``forces`` / d coefficient of friction [N], shape [collision, 4, 3]."""
    columns: np.ndarray
    """Their changes, shape [collision, 33, 4, 3]: see ``NOW`` to ``RANGE``."""
    kinks: np.ndarray
    """Whether friction has one derivative on each side: the step began with a node right over the
    border of the face that it touches where it ends, bool, shape [collision]."""


def contact_derivatives(
    model: Model,
    collisions: Collisions,
    motion: StepMotion,
    eps_u_m: wp.array | None,
    env: int,
    by_all: bool = True,
) -> ContactDerivatives:
    """Slopes of the forces of one environment's ``collisions``, which are those at the end of
    ``motion``. ``eps_u_m``: as ``FrictionPotential`` has it, None without friction. ``by_all``:
    all columns; otherwise none, for the forces alone."""
    found = {
        name: collisions.of(env, getattr(collisions, name))
        for name in ("stencils", "kinds", "stiffnesses")
    }
    count, width = len(found["kinds"]), _COLUMNS if by_all else 1
    forces = wp.zeros(count, dtype=mat43d, device=model.device)
    per_friction = wp.zeros(count, dtype=mat43d, device=model.device)
    columns = wp.zeros((count, width), dtype=mat43d, device=model.device)
    kinks = wp.zeros(count, dtype=wp.int32, device=model.device)
    if count:
        friction = model.pair_friction if eps_u_m is not None else None
        inputs = [env, collisions.lists, collisions.geometry, friction, motion, eps_u_m, forces]
        launch(_slopes_kernel, (count, width), *inputs, per_friction, columns, kinks)
    nodes = found["stencils"].reshape(-1, 4)
    return ContactDerivatives(
        nodes=nodes,
        kinds=found["kinds"],
        stiffnesses=found["stiffnesses"],
        bodies=model.surface.node_bodies.numpy()[nodes[:, [0, 3]]],
        forces=forces.numpy().reshape(-1, 4, 3),
        per_friction=per_friction.numpy().reshape(-1, 4, 3),
        columns=columns.numpy().reshape(count, width, 4, 3),
        kinks=kinks.numpy() != 0,
    )
