# SPDX-License-Identifier: Apache-2.0
"""Lagged Coulomb friction [Li et al. 2020, sec. 5]: normal force, weights and tangent plane of each
collision are frozen, which makes the sliding of one step a potential; the solver re-freezes them
until the force residual with the new values is small too.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.barrier import contact_potential_d1
from taccel_lab.ipc.collision_lists import (
    CollisionLists,
    ContactGeometry,
    closest_pair,
    collision_gap,
)
from taccel_lab.ipc.collisions import Collisions
from taccel_lab.ipc.distance.derivatives import pair_normal
from taccel_lab.ipc.distance.edge_edge_mollifier import edge_edge_cross_sq, edge_edge_mollifier
from taccel_lab.ipc.friction import (
    friction_gradient,
    friction_hessian,
    friction_potential,
    relative_displacement,
    tangential,
)
from taccel_lab.ipc.linear.scatter import NewtonSystem, add_block
from taccel_lab.ipc.reduce import sum_lists
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


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


@wp.kernel
def _lag_kernel(
    active: wp.array(dtype=wp.int32),
    lists: CollisionLists,
    geometry: ContactGeometry,
    pair_friction: wp.array2d(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    counts: wp.array(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    weights: wp.array2d(dtype=wp.vec4d),
    normals: wp.array2d(dtype=wp.vec3d),
    mu_lambdas: wp.array2d(dtype=wp.float64),
):
    env, slot = wp.tid()
    if active[env] == 0:
        return
    if slot == 0:
        counts[env] = lists.counts[env]
    if slot >= lists.counts[env]:
        return
    nodes = lists.stencils[env, slot]
    pair = closest_pair(env, lists.kinds[env, slot], nodes, positions, geometry)
    gap = collision_gap(pair, nodes, geometry)
    force = -contact_potential_d1(gap, lists.ranges[env, slot], lists.stiffnesses[env, slot])
    threshold = lists.thresholds[env, slot]
    if threshold > wp.float64(0.0):
        cross_sq = edge_edge_cross_sq(
            positions[env, nodes[0]],
            positions[env, nodes[1]],
            positions[env, nodes[2]],
            positions[env, nodes[3]],
        )
        force *= edge_edge_mollifier(cross_sq, threshold)
    mu = pair_friction[geometry.node_bodies[nodes[0]], geometry.node_bodies[nodes[3]]]
    stencils[env, slot] = nodes
    weights[env, slot] = pair.weights
    normals[env, slot] = pair_normal(pair)
    # Signed: a subtracted duplicate takes back what was counted twice. Left out, friction would
    # jump where a second face begins to count, and freezing would never settle.
    mu_lambdas[env, slot] = mu * force


@wp.func
def sliding(
    env: int,
    nodes: wp.vec4i,
    weights: wp.vec4d,
    normal: wp.vec3d,
    motion: StepMotion,
) -> wp.vec3d:
    """Tangential displacement of the two closest points against each other in this step [m]."""
    now = motion.positions
    then = motion.previous
    u = relative_displacement(
        weights,
        now[env, nodes[0]] - then[env, nodes[0]],
        now[env, nodes[1]] - then[env, nodes[1]],
        now[env, nodes[2]] - then[env, nodes[2]],
        now[env, nodes[3]] - then[env, nodes[3]],
    )
    if motion.node_is_ball[nodes[0]] != 0:
        # A ball is one node: what its surface moves by turning comes on top.
        radius = motion.node_radii[nodes[0]]
        body = motion.node_bodies[nodes[0]] - motion.first_kinematic
        turn = wp.transform_get_rotation(motion.poses[env, body]) * wp.quat_inverse(
            wp.transform_get_rotation(motion.previous_poses[env, body])
        )
        arm = -radius * normal
        u += arm - wp.quat_rotate_inv(turn, arm)
    return tangential(normal, u)


@wp.kernel
def _energy_kernel(
    active: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    weights: wp.array2d(dtype=wp.vec4d),
    normals: wp.array2d(dtype=wp.vec3d),
    mu_lambdas: wp.array2d(dtype=wp.float64),
    motion: StepMotion,
    eps_u: wp.float64,
    energies: wp.array2d(dtype=wp.float64),
):
    env, slot = wp.tid()
    if active[env] == 0 or slot >= counts[env]:
        return
    nodes = stencils[env, slot]
    u = sliding(env, nodes, weights[env, slot], normals[env, slot], motion)
    energies[env, slot] = friction_potential(u, mu_lambdas[env, slot], eps_u)


@wp.kernel
def _gradient_kernel(
    active: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    weights: wp.array2d(dtype=wp.vec4d),
    normals: wp.array2d(dtype=wp.vec3d),
    mu_lambdas: wp.array2d(dtype=wp.float64),
    motion: StepMotion,
    eps_u: wp.float64,
    gradient: wp.array2d(dtype=wp.vec3d),
):
    env, slot = wp.tid()
    if active[env] == 0 or slot >= counts[env]:
        return
    nodes = stencils[env, slot]
    w = weights[env, slot]
    u = sliding(env, nodes, w, normals[env, slot], motion)
    force = friction_gradient(u, mu_lambdas[env, slot], eps_u)
    for i in range(4):
        if w[i] != wp.float64(0.0):
            wp.atomic_add(gradient, env, nodes[i], w[i] * force)


@wp.kernel
def _hessian_kernel(
    active: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    stencils: wp.array2d(dtype=wp.vec4i),
    weights: wp.array2d(dtype=wp.vec4d),
    normals: wp.array2d(dtype=wp.vec3d),
    mu_lambdas: wp.array2d(dtype=wp.float64),
    motion: StepMotion,
    eps_u: wp.float64,
    system: NewtonSystem,
):
    env, slot = wp.tid()
    if active[env] == 0 or slot >= counts[env]:
        return
    # Without the subtracted duplicates the matrix is too large, but surely positive.
    if mu_lambdas[env, slot] <= wp.float64(0.0):
        return
    nodes = stencils[env, slot]
    w = weights[env, slot]
    n = normals[env, slot]
    u = sliding(env, nodes, w, n, motion)
    core = friction_hessian(n, u, mu_lambdas[env, slot], eps_u)
    # Held in a variable: sixteen inlined copies would only take longer to compile.
    count = int(4)
    for i in range(count):
        for j in range(count):
            if w[i] != wp.float64(0.0) and w[j] != wp.float64(0.0):
                add_block(env, nodes[i], nodes[j], w[i] * w[j] * core, system)


class FrictionPotential:
    """Frozen friction of a collision set; built only for scenes with a friction coefficient."""

    def __init__(self, model: Model, collisions: Collisions, eps_u_m: float) -> None:
        self.model = model
        self.collisions = collisions
        self.eps_u_m = eps_u_m
        """Sliding in one step below which friction is static [m]: eps_v * dt."""
        self.counts = wp.zeros(model.env_count, dtype=wp.int32, device=model.device)
        self.max_count = 0
        self._allocate(1)

    def _allocate(self, capacity: int) -> None:
        """Make room; environments that are not re-frozen now keep their lists."""
        shape, device = (self.model.env_count, capacity), self.model.device
        old = self._lists() if hasattr(self, "stencils") else None
        self.stencils = wp.zeros(shape, dtype=wp.vec4i, device=device)
        self.weights = wp.zeros(shape, dtype=wp.vec4d, device=device)
        self.normals = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self.mu_lambdas = wp.zeros(shape, dtype=wp.float64, device=device)
        """Friction coefficient times frozen normal force [N], signed, [env_count, capacity]."""
        self.energies = wp.zeros(shape, dtype=wp.float64, device=device)
        """Energy of each frozen collision [J], shape [env_count, capacity]."""
        if old is not None:
            for new, previous in zip(self._lists(), old, strict=True):
                wp.copy(new[:, : previous.shape[1]], previous)

    def _lists(self) -> list[wp.array]:
        return [self.stencils, self.weights, self.normals, self.mu_lambdas]

    def motion(
        self, positions: wp.array, previous: wp.array, poses: wp.array, previous_poses: wp.array
    ) -> StepMotion:
        """Gather what sliding is measured from."""
        motion = StepMotion()
        motion.positions, motion.previous = positions, previous
        motion.poses, motion.previous_poses = poses, previous_poses
        motion.node_radii = self.model.surface.node_radii
        motion.node_is_ball = self.model.surface.node_is_ball
        motion.node_bodies = self.model.surface.node_bodies
        motion.first_kinematic = len(self.model.scene.soft_bodies) + self.model.affine.count
        return motion

    def lag(self, active: wp.array, positions: wp.array) -> None:
        """Freeze the current collisions of the active environments at ``positions``."""
        c = self.collisions
        if self.stencils.shape[1] < c.capacity:
            self._allocate(c.capacity)
        wp.launch(
            _lag_kernel,
            dim=(self.model.env_count, max(c.max_count, 1)),
            inputs=[active, c.lists, c.geometry, self.model.pair_friction, positions],
            outputs=[self.counts, *self._lists()],
            device=self.model.device,
        )
        self.max_count = int(self.counts.numpy().max())

    def clear(self, who: np.ndarray) -> None:
        """Forget the frozen collisions of the environments ``who`` (bool, [env_count])."""
        counts = np.where(who, 0, self.counts.numpy()).astype(np.int32)
        self.counts.assign(counts)
        self.max_count = int(counts.max())

    def _launch(self, kernel: wp.Kernel, active: wp.array, motion: StepMotion, out: Any) -> None:
        if self.max_count:
            wp.launch(
                kernel,
                dim=(self.model.env_count, self.max_count),
                inputs=[active, self.counts, *self._lists(), motion, self.eps_u_m, out],
                device=self.model.device,
            )

    def energy(self, active: wp.array, motion: StepMotion) -> np.ndarray:
        """Energy of this step's sliding [J], shape [env_count]."""
        self._launch(_energy_kernel, active, motion, self.energies)
        return sum_lists(self.energies, self.counts)

    def add_gradient(self, active: wp.array, motion: StepMotion, gradient: wp.array) -> None:
        """Add d energy / dx [N] of all nodes."""
        self._launch(_gradient_kernel, active, motion, gradient)

    def add_hessian(self, active: wp.array, motion: StepMotion, system: NewtonSystem) -> None:
        """Add the positive part of the Hessian to the Newton system."""
        self._launch(_hessian_kernel, active, motion, system)
