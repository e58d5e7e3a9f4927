# SPDX-License-Identifier: Apache-2.0
"""What bodies do to each other: force, torque and smallest gap of each pair of bodies.

Every collision acts on its two bodies with opposite forces. Each side's torque is taken where that
side is touched: at its nodes, on the surface of a ball, at the foot point on a plane. Contact
forces act along the line between the two places, so that their torques cancel as well. Friction
acts across it, on both surfaces, which are a gap apart: its torques differ by gap times force, as
in every barrier method.

One thread adds up all collisions of one body in their order; nothing is added atomically.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.ipc.contact.collision_lists import (
    CollisionLists,
    ContactGeometry,
    closest_pair,
    collision_gap,
)
from taccel_lab.ipc.contact.collisions import Collisions
from taccel_lab.ipc.contact.friction import friction_gradient
from taccel_lab.ipc.device.matrices import mat43d
from taccel_lab.ipc.distance.derivatives import outer_rows, pair_normal
from taccel_lab.ipc.potentials.contact import contact_rows, stencil_size
from taccel_lab.ipc.potentials.friction import (
    FrictionPotential,
    FrozenContacts,
    StepMotion,
    sliding,
)
from taccel_lab.model import Model
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})

vec6d = wp.types.vector(length=6, dtype=wp.float64)


@wp.struct
class Interaction:
    """What one collision does, with its torques about the reference point.

    first, second: body ids. gap [m].
    on_first, on_second: force [N], torque [N m].
    """

    first: wp.int32
    second: wp.int32
    gap: wp.float64
    on_first: vec6d
    on_second: vec6d


@wp.func
def touched_at(
    env: int,
    nodes: wp.vec4i,
    i: int,
    normal: wp.vec3d,
    positions: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
) -> wp.vec3d:
    """Where a force on stencil node i acts [m]; ``normal`` points from the second body to the
    first."""
    x = positions[env, nodes[i]]
    if geometry.node_is_ball[nodes[i]] != 0:
        return x - geometry.node_radii[nodes[i]] * normal
    across = geometry.plane_normals[nodes[i]]
    if wp.length_sq(across) > wp.float64(0.0):
        other = positions[env, nodes[0]]
        return other - wp.dot(across, other - x) * across
    return x


@wp.func
def as_interaction(
    env: int,
    nodes: wp.vec4i,
    size: int,
    normal: wp.vec3d,
    gap: wp.float64,
    gradient: mat43d,
    center: wp.vec3d,
    positions: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
) -> Interaction:
    """Sum the forces, minus the gradient, on either side of a collision."""
    result = Interaction()
    result.first = geometry.node_bodies[nodes[0]]
    result.second = geometry.node_bodies[nodes[3]]
    result.gap = gap
    for i in range(size):
        force = -gradient[i]
        place = touched_at(env, nodes, i, normal, positions, geometry)
        torque = wp.cross(place - center, force)
        wrench = vec6d(force[0], force[1], force[2], torque[0], torque[1], torque[2])
        if geometry.node_bodies[nodes[i]] == result.first:
            result.on_first += wrench
        else:
            result.on_second += wrench
    return result


@wp.kernel
def _contact_kernel(
    lists: CollisionLists,
    geometry: ContactGeometry,
    positions: wp.array2d(dtype=wp.vec3d),
    center: wp.vec3d,
    starts: wp.array(dtype=wp.int32),
    interactions: wp.array(dtype=Interaction),
):
    env, slot = wp.tid()
    if slot >= starts[env + 1] - starts[env]:
        return
    at = lists.room.starts[env] + slot
    nodes = lists.stencils[at]
    kind = lists.kinds[at]
    pair = closest_pair(env, kind, nodes, positions, geometry)
    gap = collision_gap(pair, nodes, lists.insets[at], geometry)
    rows = contact_rows(env, at, pair, lists, geometry, positions)
    size = stencil_size(kind)
    interactions[starts[env] + slot] = as_interaction(
        env, nodes, size, pair_normal(pair), gap, rows, center, positions, geometry
    )


@wp.kernel
def _friction_kernel(
    frozen: FrozenContacts,
    motion: StepMotion,
    eps_u: wp.array(dtype=wp.float64),
    geometry: ContactGeometry,
    center: wp.vec3d,
    starts: wp.array(dtype=wp.int32),
    interactions: wp.array(dtype=Interaction),
):
    env, slot = wp.tid()
    if slot >= starts[env + 1] - starts[env]:
        return
    at = frozen.room.starts[env] + slot
    nodes = frozen.stencils[at]
    normal = frozen.normals[at]
    u = sliding(env, at, frozen, motion)
    force = friction_gradient(u, frozen.mu_lambdas[at], eps_u[env])
    rows = outer_rows(frozen.weights[at], force)
    none = wp.float64(wp.inf)
    interactions[starts[env] + slot] = as_interaction(
        env, nodes, 4, normal, none, rows, center, motion.positions, geometry
    )


@wp.kernel
def _add_kernel(
    starts: wp.array(dtype=wp.int32),
    interactions: wp.array(dtype=Interaction),
    wrenches: wp.array3d(dtype=vec6d),
    gaps: wp.array3d(dtype=wp.float64),
):
    env, body = wp.tid()
    for at in range(starts[env], starts[env + 1]):
        item = interactions[at]
        if item.first == body:
            gaps[env, body, item.second] = wp.min(gaps[env, body, item.second], item.gap)
        elif item.second == body:
            gaps[env, body, item.first] = wp.min(gaps[env, body, item.first], item.gap)
        if item.first != item.second:
            if item.first == body:
                wrenches[env, body, item.second] += item.on_first
            elif item.second == body:
                wrenches[env, body, item.first] += item.on_second


@wp.kernel
def _total_kernel(wrenches: wp.array3d(dtype=vec6d), totals: wp.array2d(dtype=vec6d)):
    env, body = wp.tid()
    total = vec6d()
    for other in range(wrenches.shape[2]):
        total += wrenches[env, body, other]
    totals[env, body] = total


@dataclass(frozen=True)
class PairWrenches:
    """Forces between bodies; a body's forces on itself have no resultant and are left out."""

    wrenches: wp.array
    """(Fx, Fy, Fz, Mx, My, Mz) on the first body by the second [N, N m] about the reference point,
    six float64, shape [env_count, body_count, body_count]."""
    gaps: wp.array
    """Smallest gap of each pair within reach of contact [m], else infinite; float64, shape
    [env_count, body_count, body_count]. On the diagonal: of a body with itself."""

    @classmethod
    def none(cls, model: Model) -> PairWrenches:
        """No forces, and no pair within reach."""
        shape = (model.env_count, len(model.bodies), len(model.bodies))
        return cls(
            wrenches=wp.zeros(shape, dtype=vec6d, device=model.device),
            gaps=wp.full(shape, wp.inf, dtype=wp.float64, device=model.device),
        )

    def totals(self) -> wp.array:
        """Wrench on each body by all others, six float64, shape [env_count, body_count]."""
        totals = wp.zeros(self.wrenches.shape[:2], dtype=vec6d, device=self.wrenches.device)
        launch(_total_kernel, totals.shape, self.wrenches, totals)
        return totals


def _added(model: Model, kernel: wp.Kernel, counts: wp.array, inputs: list) -> PairWrenches:
    """Forces of the collisions that ``kernel`` reads, ``counts`` of them, [env_count]: those of the
    environments one after the other, as each has its own number of them."""
    numbers = counts.numpy()
    starts = np.concatenate([[0], np.cumsum(numbers, dtype=np.int32)])
    places = wp.array(starts, dtype=wp.int32, device=model.device)
    interactions = wp.zeros(int(starts[-1]), dtype=Interaction, device=model.device)
    launch(kernel, (model.env_count, int(numbers.max(initial=0))), *inputs, places, interactions)
    result = PairWrenches.none(model)
    launch(
        _add_kernel, result.wrenches.shape[:2], places, interactions, result.wrenches, result.gaps
    )
    return result


def contact_wrenches(
    model: Model,
    collisions: Collisions,
    positions: wp.array,
    center_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> PairWrenches:
    """Normal forces of a collision set at the positions [m] it was found at."""
    inputs = [collisions.lists, collisions.geometry, positions, wp.vec3d(*center_m)]
    return _added(model, _contact_kernel, collisions.counts, inputs)


def friction_wrenches(
    model: Model,
    friction: FrictionPotential,
    geometry: ContactGeometry,
    motion: StepMotion,
    center_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> PairWrenches:
    """Tangential forces of the frozen collisions of a step, at the end of ``motion``."""
    inputs = [friction.frozen, motion, friction.eps_u_m, geometry, wp.vec3d(*center_m)]
    return _added(model, _friction_kernel, friction.counts, inputs)
