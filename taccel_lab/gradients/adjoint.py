# SPDX-License-Identifier: Apache-2.0
"""Gradients of a motion's outcome with respect to its inputs, by one adjoint solve a step.

Step k ends where the forces on the unknowns balance, R_k(x_k, x_{k-1}; p) = 0, with x all nodes:
those of gels that are free, and those that are prescribed, which follow from the poses and the
rest shape. For a loss L of positions and wrenches, from the last step to the first,

    (dR_k/dx_k)^T l_k = -(dL/dx_k + (dR_{k+1}/dx_k)^T l_{k+1})        over the free nodes,
    dL/dp = dL/dp (explicitly) + sum_k l_k . dR_k/dp,

the implicit function theorem with the recursion of a discrete adjoint: sliding is counted from
where a step began, which is all that a step knows of the ones before it. A wrench is a sum of the
same forces of collisions that R consists of, so that its gradient is one more multiplier of them.

Elastic forces are linear in the moduli, and g(x; s) = s^2 g(x / s) in the size s of a gel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.gradients.motion import GelMotion, MotionRecord
from taccel_lab.gradients.parameters import Parameters
from taccel_lab.gradients.rest_scale import RestScale
from taccel_lab.ipc.potentials.contact_derivatives import (
    BEFORE,
    NOW,
    TURN_BEFORE,
    TURN_NOW,
    ContactDerivatives,
)
from taccel_lab.ipc.potentials.friction import step_motion
from taccel_lab.model import Model
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.tangent import INDEFINITE, Tangent, sparse_matrix
from taccel_lab.state import State


def elastic_gradient(
    solver: SolverIPC, state: State, groups: Sequence[ElementArrays] | None = None
) -> np.ndarray:
    """d(elastic energy)/dx of all nodes [N], shape [env_count, node_count, 3].

    ``groups``: the elements of ``model.elastic`` with other moduli or volumes to take the forces
    with; as they are when None.
    """
    active = wp.full(solver.model.env_count, 1, dtype=wp.int32, device=solver.model.device)
    gradient = wp.zeros_like(state.positions)
    for part, group in zip(solver.elastic, groups or solver.model.elastic, strict=True):
        data = part.data
        own = data.moduli.mu, data.moduli.lam, data.moduli.ratio, data.volumes
        data.moduli.mu, data.moduli.lam = group.mu, group.lam
        data.moduli.ratio, data.volumes = group.mooney_ratio, group.volumes
        try:
            part.add_gradient(active, state.positions, gradient)
        finally:
            data.moduli.mu, data.moduli.lam, data.moduli.ratio, data.volumes = own
    return gradient.numpy()


Array = np.ndarray


@dataclass(frozen=True)
class Gradients:
    """dL / d what went into a motion; NaN in environments without gradients."""

    young_modulus: Array
    """Gradient by Young's modulus [1/Pa], shape [env_count, gel_count]; contact stiffness that
    follows it included."""
    poisson_ratio: Array
    """Shape [env_count, gel_count]."""
    friction: Array
    """Gradient by the coefficient of each pair of bodies, symmetric, shape [env_count, body_count,
    body_count]; NaN in a scene without friction, whose solver leaves it out."""
    scale: Array
    """Gradient by the size of a gel, all its rest positions times 1 + ds about the origin of its
    mesh, shape [env_count, gel_count]. What holds it scales along, tools stay."""
    poses: Array
    """Gradient by the poses of the tools, [step_count + 1, env_count, kinematic_count, 7]: by x, y,
    z [1/m], and along the unit quaternions x, y, z, w."""
    causes: list[str | None]
    """Why an environment has no gradients, None where it has."""


def pull_back(
    motion: GelMotion,
    record: MotionRecord,
    positions: Array | None = None,
    wrenches: Array | None = None,
) -> Gradients:
    """Gradients of a loss from its derivatives by what a motion gave.

    Args:
        motion: What ran it; its model may have other parameters by now.
        record: What came of it, with the parameters that gradients are taken at.
        positions: dL / d ``record.positions``, the same shape; zero when None.
        wrenches: dL / d ``record.wrenches``, the same shape; zero when None.

    Raises:
        InputError: Arrays of other shapes.
    """
    by_positions = _given(positions, record.positions, "positions")
    by_wrenches = _given(wrenches, record.wrenches, "wrenches")
    with record.parameters.installed():
        sweep = _Sweep(motion, record)
        for k in reversed(range(len(record.positions))):
            sweep.step(k, by_positions[k], by_wrenches[k])
        return sweep.result()


def _given(value: Array | None, like: Array, name: str) -> Array:
    if value is None:
        return np.zeros_like(like)
    found = np.asarray(value, dtype=np.float64)
    if found.shape != like.shape:
        raise InputError(f"dL/d {name} must have shape {like.shape}, got {found.shape}")
    return found


class _Sweep:
    """What adds up on the way back through the steps."""

    def __init__(self, motion: GelMotion, record: MotionRecord) -> None:
        model = motion.model
        self.motion, self.model, self.record = motion, model, record
        self.causes = list(record.causes)
        gels, envs = len(model.scene.soft_bodies), model.env_count
        self.young = np.zeros((envs, gels))
        self.poisson = np.zeros((envs, gels))
        self.scale = np.zeros((envs, gels))
        self.friction = np.zeros((envs, len(model.bodies), len(model.bodies)))
        tools = (len(record.poses), envs, len(model.kinematic), 3)
        self.shifts, self.turns = np.zeros(tools), np.zeros(tools)
        self.carried = np.zeros((envs, model.node_count, 3))
        """dL/dx by way of the steps behind, of the nodes where the next one to look at ends."""
        self.free_nodes = model.free_nodes.numpy()
        self.frame_nodes, self.frame_ids = model.frame_nodes.numpy(), model.frame_ids.numpy()
        names = [body.name for body in model.kinematic]
        bodies = model.scene.soft_bodies
        self.mounts = [None if b.mount is None else names.index(b.mount) for b in bodies]
        config = motion.solver.config
        self.scales = [RestScale(model, config, gel) for gel in range(gels)]
        self.by_poisson = [_by_poisson(model, record.parameters, g) for g in model.elastic]

    def state(self, k: int) -> State:
        """State after step k; at the start for -1. Failed environments are at the start."""
        record, device = self.record, self.model.device
        x, poses = record.start_m, record.poses[0]
        if k >= 0:
            ok = record.ok
            x = np.where(ok[:, None, None], record.positions[k], x)
            poses = np.where(ok[:, None, None], record.poses[k + 1], poses)
        positions = wp.array(np.ascontiguousarray(x), dtype=wp.vec3d, device=device)
        return State(
            positions=positions,
            velocities=wp.zeros_like(positions),
            poses=wp.array(np.ascontiguousarray(poses), dtype=wp.transformd, device=device),
        )

    def step(self, k: int, by_positions: Array, by_wrenches: Array) -> None:
        """Go back over step k; arguments: dL by what it gave."""
        motion = self.motion
        ok = np.array([cause is None for cause in self.causes])
        if not ok.any():
            return
        state, before = self.state(k), self.state(k - 1)
        x, solver = state.positions.numpy(), motion.solver
        tangent = Tangent(solver, state, who=ok)
        tangent.add_elements()
        elastic = solver.linear.values.numpy().copy()
        derivatives = {
            int(env): motion.derivatives(int(env), state, before.positions, before.poses, True)
            for env in np.flatnonzero(ok)
        }
        by_x = self.carried + np.where(ok[:, None, None], by_positions, 0.0)
        self.carried = np.zeros_like(by_x)
        outer = {
            env: self._of_wrenches(k, env, derivatives[env], x[env], by_wrenches[env], by_x[env])
            for env in derivatives
        }
        for env, weights in outer.items():
            _add_nodes(by_x[env], derivatives[env], derivatives[env].columns[:, NOW], weights)
        rhs = -by_x[:, self.free_nodes]
        if solver.friction is None:
            tangent.add_contact()
            solved = tangent.solve(rhs)
        else:
            solved = tangent.solve_transposed(rhs, derivatives)
            # A step minimises its energy with friction frozen: there its Hessian is positive.
            tangent.add_contact(
                step_motion(
                    self.model, state.positions, before.positions, state.poses, before.poses
                )
            )
            for env, cause in enumerate(tangent.solve(rhs).causes):
                if cause == INDEFINITE:
                    solved.causes[env] = cause
        multipliers = np.zeros_like(by_x)
        multipliers[:, self.free_nodes] = solved.solution
        for scale in self.scales:
            scale.update(tangent.active, state.positions, solver.candidates)
        for env, contact in derivatives.items():
            cause = solved.causes[env]
            if contact.kinks.any():
                cause = (
                    "it began with a node right over the border of a face that it touches at the "
                    "end, where friction has one derivative on each side: shift a body a little"
                )
            if cause is not None:
                self.causes[env] = f"step {k + 1}: {cause}"
                continue
            by_x[env, self.free_nodes] = 0.0
            inner = multipliers[env, contact.nodes]
            held = np.zeros_like(by_x[env])
            _add_nodes(held, contact, contact.columns[:, NOW], inner)
            held[self.free_nodes] = 0.0
            by_x[env] += held
            weights = inner + outer[env]
            _add_nodes(self.carried[env], contact, contact.columns[:, BEFORE], weights)
            self._of_contact(k, env, contact, weights)
            self._of_prescribed(k + 1, env, x[env], by_x[env])
        self._of_elements(k, state, elastic, multipliers, ok)
        self._of_mounts(k, tangent, x, multipliers)

    def _of_wrenches(
        self,
        k: int,
        env: int,
        derivatives: ContactDerivatives,
        x: Array,
        by_wrench: Array,
        by_x: Array,
    ) -> Array:
        """dL / d forces of the collisions by way of the wrenches [collision, 4, 3]; what the arms
        of moments add goes to ``by_x`` and to the tools."""
        weights = np.zeros_like(derivatives.forces)
        poses = self.record.poses[k + 1, env]
        for tool, touched in enumerate(self.motion.touched(derivatives)):
            force, moment = by_wrench[tool, :3], by_wrench[tool, 3:]
            on = touched[:, :, None]
            arms = x[derivatives.nodes] - poses[tool, :3]
            weights += np.where(on, force + np.cross(moment, arms), 0.0)
            by_arms = np.where(on, np.cross(derivatives.forces, moment), 0.0)
            np.add.at(by_x, derivatives.nodes, by_arms)
            self.shifts[k + 1, env, tool] -= by_arms.sum(axis=(0, 1))
        return weights

    def _of_contact(
        self, k: int, env: int, derivatives: ContactDerivatives, weights: Array
    ) -> None:
        """Adds gradients by what the forces of collisions depend on beside positions."""
        power = np.einsum("cix,cix->c", weights, derivatives.forces)
        rubbed = np.einsum("cix,cix->c", weights, derivatives.per_friction)
        first, second = derivatives.bodies.T
        np.add.at(self.friction[env], (first, second), rubbed)
        other = first != second
        np.add.at(self.friction[env], (second[other], first[other]), rubbed[other])
        if self.motion.solver.config.kappa_pa is None:
            # The contact stiffness is the larger modulus of the two bodies.
            moduli = self.model.largest_moduli.numpy()
            moduli = moduli[env % len(moduli)]
            for gel in range(self.young.shape[1]):
                mine = (derivatives.bodies == gel).any(axis=1)
                theirs = np.where(first == gel, moduli[second], moduli[first])
                rules = mine & ((moduli[gel] > theirs) | ~other)
                self.young[env, gel] += power[rules].sum() / moduli[gel]
                if (mine & other & (moduli[gel] == theirs)).any():
                    self.young[env, gel] = np.nan
        for gel, scale in enumerate(self.scales):
            self.scale[env, gel] += (weights * scale.force_derivatives(env, derivatives)).sum()
        tool = derivatives.bodies[:, 0] - self.motion.first_kinematic
        for at, columns in ((k + 1, TURN_NOW), (k, TURN_BEFORE)):
            turned = np.einsum("cnix,cix->cn", derivatives.columns[:, columns], weights)
            np.add.at(self.turns[at, env], tool[tool >= 0], turned[tool >= 0])

    def _of_prescribed(self, at: int, env: int, x: Array, by_x: Array) -> None:
        """Adds gradients by the poses that carry nodes and by the size of what is held. They come
        from dL/dx of nodes that are prescribed, and at the start of all nodes."""
        poses = self.record.poses[at, env]
        nodes, frames = self.frame_nodes, self.frame_ids
        if at == 0:
            nodes, frames = self.model.start_nodes.numpy(), self.model.start_frames.numpy()
        arms = x[nodes] - poses[frames, :3]
        np.add.at(self.shifts[at, env], frames, by_x[nodes])
        np.add.at(self.turns[at, env], frames, np.cross(arms, by_x[nodes]))
        for gel in range(len(self.mounts)):
            place = self.model.bodies[gel].node_slice
            grown = x[place] - self._centre(at, env, gel)
            self.scale[env, gel] += (by_x[place] * grown).sum()

    def _centre(self, at: int, env: int, gel: int) -> Array:
        """Where the origin of a gel's mesh is [m]."""
        mount, body = self.mounts[gel], self.model.scene.soft_bodies[gel]
        if mount is not None:
            return self.record.poses[at, env, mount, :3]
        if body.initial_pose is None:
            return np.zeros(3)
        poses = np.atleast_2d(body.initial_pose)
        return poses[env % len(poses), :3]

    def _of_elements(
        self, k: int, state: State, elastic: Array, multipliers: Array, who: Array
    ) -> None:
        """Adds gradients by moduli and size, as far as elements feel them."""
        solver, model, x = self.motion.solver, self.model, state.positions.numpy()
        forces = elastic_gradient(solver, state)
        by_poisson = elastic_gradient(solver, state, self.by_poisson)
        pulls = {
            int(env): sparse_matrix(model.pattern, elastic[env]) for env in np.flatnonzero(who)
        }
        for gel in range(len(self.mounts)):
            place = model.bodies[gel].node_slice
            rows = slice(*model.body_rows()[gel])
            power = np.einsum("enx,enx->e", multipliers[:, place], forces[:, place])
            more = np.einsum("enx,enx->e", multipliers[:, place], by_poisson[:, place])
            self.young[:, gel] += power / self.record.parameters.of_gel(gel)[0]
            self.poisson[:, gel] += more
            for env, matrix in pulls.items():
                # K x is that of the gel alone: its elements hold no node of another.
                around = np.zeros((model.free_count, 3))
                around[rows] = x[env, self.free_nodes[rows]] - self._centre(k + 1, env, gel)
                pull = multipliers[env, self.free_nodes].ravel() @ (matrix @ around.ravel())
                self.scale[env, gel] += 2 * power[env] - pull

    def _of_mounts(self, k: int, tangent: Tangent, x: Array, multipliers: Array) -> None:
        """Adds gradients by the poses of tools that hold gels, as far as elements feel them."""
        mine = multipliers[:, self.free_nodes]
        for tool in {mount for mount in self.mounts if mount is not None}:
            nodes = self.frame_nodes[self.frame_ids == tool]
            arms = x[:, nodes] - self.record.poses[k + 1, :, tool, None, :3]
            for axis, unit in enumerate(np.eye(3)):
                for sums, by_nodes in (
                    (self.shifts, np.broadcast_to(unit, arms.shape)),
                    (self.turns, np.cross(unit, arms)),
                ):
                    moves = np.zeros_like(x)
                    moves[:, nodes] = by_nodes
                    pull = tangent.pull_of(moves)
                    sums[k + 1, :, tool, axis] -= np.einsum("erx,erx->e", mine, pull)

    def result(self) -> Gradients:
        """Gradients with the part of the start, and NaN where there are none."""
        record = self.record
        lost = np.array([cause is not None for cause in self.causes])
        for env in np.flatnonzero(~lost):
            self._of_prescribed(0, int(env), record.start_m[env], self.carried[env])
        friction = self.friction
        if self.motion.solver.friction is None:
            friction = np.full_like(friction, np.nan)
        poses = _by_pose(record.poses, self.shifts, self.turns)
        for array in (self.young, self.poisson, friction, self.scale):
            array[lost] = np.nan
        poses[:, lost] = np.nan
        return Gradients(self.young, self.poisson, friction, self.scale, poses, self.causes)


def _add_nodes(
    by_x: Array, derivatives: ContactDerivatives, columns: Array, weights: Array
) -> None:
    """Add (d forces / d x)^T ``weights`` [collision, 4, 3] to ``by_x``, [node_count, 3]."""
    found = np.einsum("cnix,cix->cn", columns, weights).reshape(-1, 4, 3)
    np.add.at(by_x, derivatives.nodes, found)


def _by_poisson(model: Model, parameters: Parameters, group: ElementArrays) -> ElementArrays:
    """The elements with d moduli / d nu in place of the moduli, in which forces are linear."""
    envs, count = model.env_count, group.element_count
    shared = group.mu.size == count
    mu, lam = np.zeros((envs, count)), np.zeros((envs, count))
    for body, first, end in group.bodies:
        young, nu = (np.broadcast_to(value, envs) for value in parameters.of_gel(body))
        mu[:, first:end] = (-young / (2 * (1 + nu) ** 2))[:, None]
        slope = young * (1 + 2 * nu**2) / ((1 + nu) ** 2 * (1 - 2 * nu) ** 2)
        lam[:, first:end] = slope[:, None]

    def put(values: Array) -> wp.array:
        rows = values[:1] if shared else values
        return wp.array(rows.ravel(), dtype=wp.float64, device=model.device)

    return replace(group, mu=put(mu), lam=put(lam))


def _by_pose(poses: Array, shifts: Array, turns: Array) -> Array:
    """dL by poses from those by shifts and by small turns about the world's axes: a change dq of a
    unit quaternion q turns by the vector part of 2 dq q*."""
    v, s = poses[..., 3:6], poses[..., 6:]
    by_v = 2 * (s * turns - np.cross(v, turns))
    by_s = -2 * (turns * v).sum(axis=-1, keepdims=True)
    return np.concatenate([shifts, by_v, by_s], axis=-1)
