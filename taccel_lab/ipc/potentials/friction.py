# SPDX-License-Identifier: Apache-2.0
"""Lagged Coulomb friction [Li et al. 2020, sec. 5]: normal force, weights and tangent plane of each
collision are frozen, which makes the sliding of one step a potential; the solver re-freezes them
until the force residual with the new values is small too.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from taccel_lab.ipc.contact.barrier import contact_potential_d1
from taccel_lab.ipc.contact.collision_lists import (
    CollisionLists,
    ContactGeometry,
    closest_pair,
    collision_gap,
)
from taccel_lab.ipc.contact.collisions import Collisions
from taccel_lab.ipc.contact.friction import (
    friction_gradient,
    friction_hessian,
    friction_potential,
    normal_motion,
    relative_displacement,
    tangential,
    way_in,
)
from taccel_lab.ipc.device.ragged_lists import ListRoom, entry_types, list_end
from taccel_lab.ipc.device.sums import ReproducibleSums, SumStage, add_vector
from taccel_lab.ipc.distance.derivatives import pair_normal
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.potentials.contact import mollifier
from taccel_lab.ipc.potentials.energy import EnergyTerm
from taccel_lab.ipc.potentials.stencil_rows import STENCIL_THREADS, add_weighted_block, row_parts
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask, Envs, env_at, place_count
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.kinematics import turn_between
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False, "block_dim": STENCIL_THREADS})


@wp.struct
class FrozenContacts:
    """Collisions as they were when friction was frozen.

    room: where those of each environment are: as in the list that they were frozen from.
    stencils: nodes, [capacity] as all below. weights: of the nodes in the relative motion of both
    sides. normals: unit. mu_lambdas: friction coefficient times normal force [N], signed.
    normal_motions: relative motion since the start of the step that is no sliding [m], see
    ``contact.friction``.
    """

    room: ListRoom
    stencils: wp.array(dtype=wp.vec4i)
    weights: wp.array(dtype=wp.vec4d)
    normals: wp.array(dtype=wp.vec3d)
    mu_lambdas: wp.array(dtype=wp.float64)
    normal_motions: wp.array(dtype=wp.vec3d)


_FROZEN = entry_types(FrozenContacts)


@wp.struct
class StepMotion:
    """Where everything is and where it was at the start of the step.

    positions, previous: nodes [m], [env_count, node_count].
    poses, previous_poses: world_from_body of the kinematic bodies, [env_count, kinematic_count].
    node_radii [m], node_is_ball, node_bodies: see ``SurfaceArrays``, [node_count].
    first_kinematic: body id of the first kinematic body.
    """

    positions: wp.array2d(dtype=wp.vec3d)
    previous: wp.array2d(dtype=wp.vec3d)
    poses: wp.array2d(dtype=wp.transformd)
    previous_poses: wp.array2d(dtype=wp.transformd)
    node_radii: wp.array(dtype=wp.float64)
    node_is_ball: wp.array(dtype=wp.int32)
    node_bodies: wp.array(dtype=wp.int32)
    first_kinematic: wp.int32


@wp.func
def freeze_contact(
    env: int,
    at: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    pair_friction: wp.array3d(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    previous: wp.array2d(dtype=wp.vec3d),
    frozen: FrozenContacts,
):
    """Freeze normal force, weights and normal of one collision."""
    nodes = lists.stencils[at]
    kind = lists.kinds[at]
    pair = closest_pair(env, kind, nodes, positions, geometry)
    gap = collision_gap(pair, nodes, lists.insets[at], geometry)
    force = -contact_potential_d1(gap, lists.ranges[at], lists.stiffnesses[at])
    force *= mollifier(env, nodes, lists.thresholds[at], positions)
    first = geometry.node_bodies[nodes[0]]
    second = geometry.node_bodies[nodes[3]]
    mu = pair_friction[env % pair_friction.shape[0], first, second]
    frozen.stencils[at] = nodes
    frozen.weights[at] = pair.weights
    frozen.normals[at] = pair_normal(pair)
    # Signed: a subtracted duplicate takes back what was counted twice. Left out, friction would
    # jump where a second face begins to count, and freezing would never settle.
    frozen.mu_lambdas[at] = mu * force
    frozen.normal_motions[at] = wp.vec3d()
    # Normals of a ball turn too little to matter, and its shear would lean on dhat twice as much.
    if geometry.node_is_ball[nodes[0]] == 0:
        way = way_in(env, kind, nodes, pair, positions, previous, geometry)
        frozen.normal_motions[at] = normal_motion(way, pair_normal(pair))


@wp.kernel
def _lag_kernel(
    active: Envs,
    lanes: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    pair_friction: wp.array3d(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    previous: wp.array2d(dtype=wp.vec3d),
    frozen: FrozenContacts,
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    first = lists.room.starts[env]
    end = list_end(env, lists.room)
    if lane == 0:
        frozen.room.counts[env] = end - first
    for at in range(first + lane, end, lanes):
        freeze_contact(env, at, lists, geometry, pair_friction, positions, previous, frozen)


@wp.func
def relative_motion(env: int, at: int, frozen: FrozenContacts, motion: StepMotion) -> wp.vec3d:
    """Displacement of the two closest points against each other since they touched, in this step
    [m], of which the tangential part is sliding."""
    nodes = frozen.stencils[at]
    normal = frozen.normals[at]
    now = motion.positions
    then = motion.previous
    u = relative_displacement(
        frozen.weights[at],
        now[env, nodes[0]] - then[env, nodes[0]],
        now[env, nodes[1]] - then[env, nodes[1]],
        now[env, nodes[2]] - then[env, nodes[2]],
        now[env, nodes[3]] - then[env, nodes[3]],
    )
    u -= frozen.normal_motions[at]
    if motion.node_is_ball[nodes[0]] != 0:
        # A ball is one node: what its surface moves by turning comes on top.
        radius = motion.node_radii[nodes[0]]
        body = motion.node_bodies[nodes[0]] - motion.first_kinematic
        turn = wp.transform_get_rotation(motion.poses[env, body]) * wp.quat_inverse(
            wp.transform_get_rotation(motion.previous_poses[env, body])
        )
        arm = -radius * normal
        u += arm - wp.quat_rotate_inv(turn, arm)
    return u


@wp.func
def sliding(env: int, at: int, frozen: FrozenContacts, motion: StepMotion) -> wp.vec3d:
    """Tangential part of ``relative_motion`` [m]."""
    return tangential(frozen.normals[at], relative_motion(env, at, frozen, motion))


@wp.kernel
def _friction_energy_kernel(
    active: Envs,
    lanes: int,
    frozen: FrozenContacts,
    motion: StepMotion,
    eps_u: wp.array(dtype=wp.float64),
    energies: wp.array(dtype=wp.float64),
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(frozen.room.starts[env] + lane, list_end(env, frozen.room), lanes):
        u = sliding(env, at, frozen, motion)
        energies[at] = friction_potential(u, frozen.mu_lambdas[at], eps_u[env])


@wp.kernel
def _friction_gradient_kernel(
    active: Envs,
    lanes: int,
    frozen: FrozenContacts,
    motion: StepMotion,
    eps_u: wp.array(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.vec3d),
    sums: SumStage,
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(frozen.room.starts[env] + lane, list_end(env, frozen.room), lanes):
        nodes = frozen.stencils[at]
        w = frozen.weights[at]
        u = sliding(env, at, frozen, motion)
        force = friction_gradient(u, frozen.mu_lambdas[at], eps_u[env])
        for i in range(4):
            if w[i] != wp.float64(0.0):
                add_vector(env, nodes[i], w[i] * force, gradient, sums)


@wp.kernel
def _friction_hessian_kernel(
    active: Envs,
    lanes: int,
    frozen: FrozenContacts,
    motion: StepMotion,
    eps_u: wp.array(dtype=wp.float64),
    sharpness: wp.array(dtype=wp.float64),
    parts: int,
    system: NewtonSystem,
):
    place, lane, part = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(frozen.room.starts[env] + lane, list_end(env, frozen.room), lanes):
        mu_lambda = frozen.mu_lambdas[at]
        # Without the subtracted duplicates the matrix is too large, but surely positive.
        if mu_lambda > wp.float64(0.0):
            nodes = frozen.stencils[at]
            w = frozen.weights[at]
            n = frozen.normals[at]
            u = sliding(env, at, frozen, motion)
            core = friction_hessian(n, u, mu_lambda, eps_u[env], sharpness[env])
            add_weighted_block(env, nodes, w, core, part, parts, system)


@wp.struct
class ToolWays:
    """What the tools do from where sliding counts to the end of a step.

    starts, ends: world_from_body, [env_count, kinematic_count] as all.
    radii: reach from their origins [m].
    share: largest static range over the longest way; 0 for the whole range, whatever they do.
    """

    starts: wp.array2d(dtype=wp.transformd)
    ends: wp.array2d(dtype=wp.transformd)
    radii: wp.array2d(dtype=wp.float64)
    share: wp.float64


_LEAST_RANGE = wp.constant(wp.float64(1e-3))
"""Part of the static range that a step keeps in which no tool moves: friction stays smooth."""


@wp.func
def longest_way(env: int, tools: ToolWays) -> wp.float64:
    """How far any point of any tool goes at most [m]."""
    longest = wp.float64(0.0)
    for tool in range(tools.starts.shape[1]):
        start = tools.starts[env, tool]
        end = tools.ends[env, tool]
        shift = wp.length(wp.transform_get_translation(end) - wp.transform_get_translation(start))
        turn = turn_between(wp.transform_get_rotation(start), wp.transform_get_rotation(end))
        longest = wp.max(longest, shift + tools.radii[env, tool] * turn)
    return longest


@wp.kernel
def _begin_friction_kernel(
    who: wp.array(dtype=wp.int32),
    dts: wp.array(dtype=wp.float64),
    whole_dts: wp.array(dtype=wp.float64),
    whole_range: wp.float64,
    tools: ToolWays,
    counts: wp.array(dtype=wp.int32),
    ranges: wp.array(dtype=wp.float64),
):
    """Nothing is frozen yet; a part of a step has that part of the static range."""
    env = wp.tid()
    if who[env] != 0:
        counts[env] = 0
        widest = whole_range * (dts[env] / whole_dts[env])
        ranges[env] = widest
        if tools.share > wp.float64(0.0):
            part = tools.share * longest_way(env, tools)
            ranges[env] = wp.clamp(part, _LEAST_RANGE * widest, widest)


def step_motion(
    model: Model,
    positions: wp.array,
    previous: wp.array,
    poses: wp.array,
    previous_poses: wp.array,
) -> StepMotion:
    """Gather what sliding is measured from."""
    motion = StepMotion()
    motion.positions, motion.previous = positions, previous
    motion.poses, motion.previous_poses = poses, previous_poses
    motion.node_radii = model.surface.node_radii
    motion.node_is_ball = model.surface.node_is_ball
    motion.node_bodies = model.surface.node_bodies
    motion.first_kinematic = len(model.scene.soft_bodies) + model.affine.count
    return motion


class FrictionPotential(EnergyTerm):
    """Frozen friction of a collision set; built only for scenes with a friction coefficient."""

    def __init__(
        self,
        model: Model,
        collisions: Collisions,
        static_range_m: float,
        in_any_order: bool = False,
    ) -> None:
        """``static_range_m``: sliding in a whole step below which friction is static.
        ``in_any_order``: see ``ContactPotential``."""
        self.model = model
        shape = (model.env_count, model.node_count)
        self.sums = ReproducibleSums(shape, model.device, in_any_order)
        """How forces are added."""
        self.collisions = collisions
        self._static_range_m = static_range_m
        self.eps_u_m = wp.full(
            model.env_count, static_range_m, dtype=wp.float64, device=model.device
        )
        """Sliding in the step that was begun below which friction is static [m], float64,
        shape [env_count]: eps_v * dt, so that steps of any length creep at the same speed, or a
        part of the tools' way, so that paths of any number of steps creep as far."""
        self.frozen = FrozenContacts()
        """The collisions as they were frozen."""
        self.counts = wp.zeros(model.env_count, dtype=wp.int32, device=model.device)
        """Frozen collisions, int32, shape [env_count]."""
        self.energies = wp.zeros(0, dtype=wp.float64, device=model.device)
        """Energy of each frozen collision [J], float64, where it is in the list."""
        room = ListRoom()
        room.counts, room.starts, room.peaks = self.counts, collisions.starts, collisions.peaks
        self.frozen.room = room
        for name, dtype in _FROZEN.items():
            setattr(self.frozen, name, wp.zeros(0, dtype=dtype, device=model.device))
        collisions.entry_bytes += 8 + sum(map(wp.types.type_size_in_bytes, _FROZEN.values()))
        collisions.follow(self._fit)

    @property
    def room(self) -> ListRoom:
        """Where the frozen collisions are."""
        return self.frozen.room

    def _fit(self, before: wp.array) -> None:
        """Make room for as many as there may be collisions; what is frozen stays."""
        c, frozen = self.collisions, self.frozen
        for name in _FROZEN:
            setattr(frozen, name, c.moved(getattr(frozen, name), self.counts, before))
        if len(self.energies) != c.capacity:
            self.energies = wp.zeros(c.capacity, dtype=wp.float64, device=self.model.device)

    def lag(self, active: EnvMask, positions: wp.array, previous: wp.array) -> None:
        """Freeze the current collisions of the active environments at ``positions``, in a step that
        began at ``previous``."""
        c = self.collisions
        inputs = [c.lists, c.geometry, self.model.pair_friction, positions, previous, self.frozen]
        self._launch(_lag_kernel, active, *inputs)

    def begin_step(
        self, who: wp.array, dts: wp.array, whole_dts: wp.array, tools: ToolWays | None = None
    ) -> None:
        """Forget the frozen collisions of the environments ``who`` (int32, [env_count]), whose
        steps are as long as ``dts`` says [s], float64, [env_count], and have the whole static range
        if that is ``whole_dts`` [s], or what the way of ``tools`` leaves of it."""
        tools = tools or ToolWays()
        inputs = [who, dts, whole_dts, self._static_range_m, tools, self.counts, self.eps_u_m]
        launch(_begin_friction_kernel, self.model.env_count, *inputs)

    def _launch(self, kernel: wp.Kernel, active: EnvMask, *rest: Any) -> None:
        m = self.model
        lanes = lane_count(m.device, place_count(active), self.collisions.largest_room)
        launch(kernel, (m.env_count, lanes), active, lanes, *rest)

    def write_energies(self, active: EnvMask, motion: StepMotion) -> None:
        """Fill ``energies`` of this step's sliding [J]."""
        inputs = [self.frozen, motion, self.eps_u_m, self.energies]
        self._launch(_friction_energy_kernel, active, *inputs)

    def add_gradient(self, active: EnvMask, motion: StepMotion, gradient: wp.array) -> None:
        """Add d energy / dx [N] of all nodes."""
        for stage in self.sums.stages():
            inputs = [self.frozen, motion, self.eps_u_m, gradient, stage]
            self._launch(_friction_gradient_kernel, active, *inputs)

    def add_hessian(
        self,
        active: EnvMask,
        motion: StepMotion,
        system: NewtonSystem,
        sharpness: wp.array | None = None,
    ) -> None:
        """Add the positive part of the Hessian to the Newton system; ``sharpness``: see
        ``friction_hessian``, float64, [env_count]; 1 when None."""
        m = self.model
        if sharpness is None:
            sharpness = wp.full(m.env_count, 1.0, dtype=wp.float64, device=m.device)
        lanes = lane_count(m.device, place_count(active), self.collisions.largest_room)
        parts = row_parts(m.device, place_count(active), lanes)
        inputs = [active, lanes, self.frozen, motion, self.eps_u_m, sharpness, parts, system]
        launch(_friction_hessian_kernel, (m.env_count, lanes, parts), *inputs)
