# SPDX-License-Identifier: Apache-2.0
"""How friction changes along a displacement when nothing of it is frozen.

Frozen friction is a potential, and its Hessian in the Newton matrix is symmetric. What freezing
leaves out is not: friction follows the normal force, lambda = -E'(gap), and the tangent plane.
With m the relative motion since the step began, a = m . n, n0 the normal where it began, and c
what of a the way in counts along it (``friction.WayIn``),

    F = mu lambda f1(|u|) u / |u|,   u = (I - n n^T) v,   v = m - w,   w = a (n + c (n0 - n)),
    dF = mu dlambda f1 u / |u| + mu lambda (f1 du / |u| + (f1' - f1 / |u|) u (u . du) / |u|^2),
    dlambda = -E'' n . dm,   du = (I - n n^T) (dm - dw) - (n . v) dn - (dn . v) n.

The change of the normal has the part t (t . dm) / d along a tangent t that the closest points do
not slide along, and -t (c n . dx) along one that they do (``PairFrame``). Over a sharp edge it
turns a full step from one side to the other. How the weights slide is left out, as is the change
of the mollifier of nearly parallel edges: both are small where contacts have settled.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.contact.barrier import contact_potential_d1, contact_potential_d2
from taccel_lab.ipc.contact.collision_lists import (
    CollisionLists,
    ContactGeometry,
    closest_pair,
    collision_gap,
)
from taccel_lab.ipc.contact.friction import (
    friction_f1_over_u,
    friction_f2,
    friction_hessian,
    normal_motion_change,
    tangential,
    way_in,
)
from taccel_lab.ipc.device.ragged_lists import list_end
from taccel_lab.ipc.device.sums import SumStage, add_vector
from taccel_lab.ipc.distance.closest_pairs import ClosestPair, combine
from taccel_lab.ipc.distance.derivatives import pair_frame, pair_normal
from taccel_lab.ipc.distance.edge_edge_mollifier import (
    edge_edge_cross_sq,
    edge_edge_cross_sq_gradient,
    edge_edge_mollifier,
    edge_edge_mollifier_d1,
)
from taccel_lab.ipc.potentials.friction import (
    FrictionPotential,
    FrozenContacts,
    StepMotion,
    relative_motion,
    sliding,
)
from taccel_lab.ipc.potentials.stencil_rows import STENCIL_THREADS
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False, "block_dim": STENCIL_THREADS})


@wp.func
def node_difference(
    env: int,
    weights: wp.vec4d,
    nodes: wp.vec4i,
    vectors: wp.array2d(dtype=wp.vec3d),
) -> wp.vec3d:
    """Weighted sum of nodal vectors, for weights whose sum is zero."""
    return combine(
        weights,
        vectors[env, nodes[0]],
        vectors[env, nodes[1]],
        vectors[env, nodes[2]],
        vectors[env, nodes[3]],
    )


@wp.struct
class PairChange:
    """How a pair changes along nodal displacements.

    approach: of the distance [m]. moved: relative motion of the two points of the bodies that are
    closest now [m]. normal: change of the unit normal. weights: change of the weights, as the
    closest points slide.
    """

    approach: wp.float64
    moved: wp.vec3d
    normal: wp.vec3d
    weights: wp.vec4d


@wp.func
def pair_change(
    env: int,
    kind: int,
    nodes: wp.vec4i,
    pair: ClosestPair,
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
) -> PairChange:
    """Change of a pair along nodal displacements [m]."""
    change = PairChange()
    change.moved = node_difference(env, pair.weights, nodes, displacements)
    if kind == 4:
        change.approach = wp.dot(pair_normal(pair), change.moved)
        return change
    frame = pair_frame(
        pair,
        positions[env, nodes[0]],
        positions[env, nodes[1]],
        positions[env, nodes[2]],
        positions[env, nodes[3]],
    )
    n = wp.vec3d(frame.axes[0, 0], frame.axes[1, 0], frame.axes[2, 0])
    first = wp.vec3d(frame.axes[0, 1], frame.axes[1, 1], frame.axes[2, 1])
    second = wp.vec3d(frame.axes[0, 2], frame.axes[1, 2], frame.axes[2, 2])
    change.approach = wp.dot(n, change.moved)
    distance = wp.sqrt(pair.distance_sq)
    # Where the closest points slide, a tangent turns with its feature, and the normal with it.
    by_first = wp.dot(first, change.moved)
    by_second = wp.dot(second, change.moved)
    if pair.free_count > 0:
        turned = distance * wp.dot(n, node_difference(env, frame.slide_1, nodes, displacements))
        change.weights -= (by_first + turned) * frame.slide_1
        by_first = -turned
    if pair.free_count > 1:
        turned = distance * wp.dot(n, node_difference(env, frame.slide_2, nodes, displacements))
        change.weights -= (by_second + turned) * frame.slide_2
        by_second = -turned
    change.normal = (by_first * first + by_second * second) / distance
    return change


@wp.func
def normal_force_change(
    env: int,
    at: int,
    pair: ClosestPair,
    approach: wp.float64,
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
) -> wp.float64:
    """Change of the normal force of a collision [N] as its distance changes by ``approach`` [m]."""
    nodes = lists.stencils[at]
    gap = collision_gap(pair, nodes, lists.insets[at], geometry)
    change = -contact_potential_d2(gap, lists.ranges[at], lists.stiffnesses[at]) * approach
    threshold = lists.thresholds[at]
    if threshold > wp.float64(0.0):
        x0 = positions[env, nodes[0]]
        x1 = positions[env, nodes[1]]
        x2 = positions[env, nodes[2]]
        x3 = positions[env, nodes[3]]
        cross_sq = edge_edge_cross_sq(x0, x1, x2, x3)
        change *= edge_edge_mollifier(cross_sq, threshold)
        rows = edge_edge_cross_sq_gradient(x0, x1, x2, x3)
        turned = wp.float64(0.0)
        for i in range(4):
            turned += wp.dot(rows[i], displacements[env, nodes[i]])
        force = -contact_potential_d1(gap, lists.ranges[at], lists.stiffnesses[at])
        change += edge_edge_mollifier_d1(cross_sq, threshold) * turned * force
    return change


@wp.func
def sliding_change(
    env: int,
    at: int,
    kind: int,
    now: ClosestPair,
    pair: PairChange,
    geometry: ContactGeometry,
    frozen: FrozenContacts,
    motion: StepMotion,
) -> wp.vec3d:
    """Change of the sliding of a collision [m]."""
    nodes = frozen.stencils[at]
    n = frozen.normals[at]
    v = relative_motion(env, at, frozen, motion)
    slid = pair.moved + node_difference(env, pair.weights, nodes, motion.positions)
    slid -= node_difference(env, pair.weights, nodes, motion.previous)
    if geometry.node_is_ball[nodes[0]] == 0:
        way = way_in(env, kind, nodes, now, motion.positions, motion.previous, geometry)
        came_by = wp.dot(v + frozen.normal_motions[at], pair.normal) + wp.dot(slid, n)
        slid -= normal_motion_change(way, n, came_by, pair.approach, pair.normal, wp.vec3d())
    return tangential(n, slid) - wp.dot(n, v) * pair.normal - wp.dot(pair.normal, v) * n


@wp.kernel
def _friction_change_kernel(
    active: Envs,
    lanes: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    pair_friction: wp.array3d(dtype=wp.float64),
    frozen: FrozenContacts,
    motion: StepMotion,
    eps_u: wp.array(dtype=wp.float64),
    sharpness: wp.array(dtype=wp.float64),
    displacements: wp.array2d(dtype=wp.vec3d),
    forces: wp.array2d(dtype=wp.vec3d),
    sums: SumStage,
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(frozen.room.starts[env] + lane, list_end(env, frozen.room), lanes):
        nodes = frozen.stencils[at]
        kind = lists.kinds[at]
        w = frozen.weights[at]
        n = frozen.normals[at]
        mu_lambda = frozen.mu_lambdas[at]
        x = motion.positions
        first = geometry.node_bodies[nodes[0]]
        second = geometry.node_bodies[nodes[3]]
        mu = pair_friction[env % pair_friction.shape[0], first, second]
        now = closest_pair(env, kind, nodes, x, geometry)
        pair = pair_change(env, kind, nodes, now, x, displacements)
        pressed = mu * normal_force_change(
            env, at, now, pair.approach, lists, geometry, x, displacements
        )
        du = sliding_change(env, at, kind, now, pair, geometry, frozen, motion)
        u = sliding(env, at, frozen, motion)
        size = wp.length(u)
        across = friction_f1_over_u(size, eps_u[env])
        along = friction_f2(size, eps_u[env])
        direction = wp.normalize(u)
        bend = (along - across) * wp.dot(direction, du)
        change = pressed * across * u + mu_lambda * (across * du + bend * direction)
        if mu_lambda > wp.float64(0.0):
            core = friction_hessian(n, u, mu_lambda, eps_u[env], sharpness[env])
            change -= core * pair.moved
        force = mu_lambda * across * u
        for i in range(4):
            if w[i] != wp.float64(0.0):
                add_vector(env, nodes[i], w[i] * change + pair.weights[i] * force, forces, sums)


def add_friction_change(
    friction: FrictionPotential,
    active: EnvMask,
    motion: StepMotion,
    sharpness: wp.array,
    displacements: wp.array,
    forces: wp.array,
) -> None:
    """Add to ``forces`` [N] by how much more the friction of all nodes changes along
    ``displacements`` [m] than its frozen Hessian of this ``sharpness`` says, in active
    environments, whose friction was frozen where they are, from their present collisions."""
    m, c = friction.model, friction.collisions
    lanes = lane_count(m.device, m.env_count, c.largest_room)
    for stage in friction.sums.stages():
        inputs = [active, lanes, c.lists, c.geometry, m.pair_friction, friction.frozen, motion]
        inputs += [friction.eps_u_m, sharpness, displacements, forces, stage]
        launch(_friction_change_kernel, (m.env_count, lanes), *inputs)
