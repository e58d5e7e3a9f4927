# SPDX-License-Identifier: Apache-2.0
"""A motion of tools against gels that remembers what its gradients need.

Each step is one undivided quasi-static step of ``SolverIPC`` to a tighter tolerance than usual: it
ends where the forces balance, with friction frozen where it ends, and friction counts sliding from
where it began. A step that would only converge in parts is no step with gradients: the environment
is left out from there on, with its cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.gradients.parameters import Parameters
from taccel_lab.ipc.potentials.contact_derivatives import ContactDerivatives, contact_derivatives
from taccel_lab.ipc.potentials.friction import step_motion
from taccel_lab.model import Model
from taccel_lab.scene import MaterialField
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC
from taccel_lab.state import State, as_poses, initial_state

TIGHT = SolverConfig(relative_tolerance=1e-8, absolute_tolerance_n=1e-10)
"""Derivatives are those of a balance of forces: they are as exact as it is."""


@dataclass(frozen=True)
class MotionRecord:
    """A motion that was run; rows of an environment are NaN from the step on that failed there."""

    poses: np.ndarray
    """world_from_body of the tools at the start and after each step (x, y, z [m], quaternion x, y,
    z, w), shape [step_count + 1, env_count, kinematic_count, 7]."""
    start_m: np.ndarray
    """All nodes at the start [m], shape [env_count, node_count, 3]."""
    positions: np.ndarray
    """All nodes after each step [m], shape [step_count, env_count, node_count, 3]."""
    wrenches: np.ndarray
    """Force [N] and moment about the tool's origin [N m] of what it touches on each tool after each
    step, world axes, shape [step_count, env_count, kinematic_count, 6]. Forces act at the nodes of
    what is touched."""
    causes: list[str | None]
    """Why an environment has no gradients, None where it has."""
    parameters: Parameters
    """Moduli and friction that it was run with."""
    seconds: float
    """Wall time of the steps."""

    @property
    def ok(self) -> np.ndarray:
        """Environments in which all steps converged, bool, shape [env_count]."""
        return np.array([cause is None for cause in self.causes])


class GelMotion:
    """Runs motions of one model, for ``gradients.pull_back``."""

    def __init__(self, model: Model, config: SolverConfig = TIGHT) -> None:
        """
        Args:
            model: Elastic gels of uniform material, kinematic bodies and planes, quasi-static.
            config: The solver's settings; its steps are not halved, and the static range of
                friction is ``friction_eps_m`` in all of them, as no derivative follows a range.

        Raises:
            InputError: Any other model.
        """
        if not model.scene.time.quasi_static:
            raise InputError(
                "gradients need a quasi-static scene of gels, tools and planes; affine bodies, "
                "joints and inertia have none: move the tool as a KinematicBody, and leave "
                "TimeStepping at quasi_static=True"
            )
        for body in model.scene.soft_bodies:
            if isinstance(body.material, MaterialField):
                raise InputError(
                    f"gradients need a gel of one material: that of {body.name!r} varies by tet"
                )
        self.model = model
        undivided = replace(config, max_substep_halvings=0, friction_step_share=0.0)
        self.solver = SolverIPC(model, undivided)

    def run(self, poses: np.ndarray) -> MotionRecord:
        """Move the tools through ``poses`` from rest: see ``MotionRecord.poses``."""
        model, solver = self.model, self.solver
        poses = np.asarray(poses, dtype=np.float64)
        if poses.ndim != 4 or len(poses) < 2:
            raise InputError(
                "poses must have shape [step_count + 1, env_count, kinematic_count, 7] with at "
                f"least one step, got {poses.shape}"
            )
        poses = np.stack([as_poses(model, row) for row in poses])
        parameters = Parameters.of(model)
        state = initial_state(model, poses[0])
        start = state.positions.numpy().copy()
        shape = (len(poses) - 1, model.env_count)
        positions = np.full((*shape, model.node_count, 3), np.nan)
        wrenches = np.full((*shape, len(model.kinematic), 6), np.nan)
        causes: list[str | None] = [None] * model.env_count
        seconds = 0.0
        for k, target in enumerate(poses[1:]):
            who = np.array([cause is None for cause in causes])
            if not who.any():
                break
            report = solver.step(state, target, who=who)
            seconds += report.seconds
            found = state.positions.numpy()
            for env in np.flatnonzero(who):
                if not report.converged[env]:
                    status = EnvStatus(report.status[env]).name
                    causes[env] = (
                        f"step {k + 1} did not converge undivided ({status}): take smaller steps"
                    )
                    continue
                positions[k, env] = found[env]
                derivatives = self.derivatives(
                    int(env), state, solver.origin, solver.origin_poses, False
                )
                wrenches[k, env] = self._wrenches(derivatives, found[env], target[env])
        return MotionRecord(poses, start, positions, wrenches, causes, parameters, seconds)

    def derivatives(
        self, env: int, state: State, before: wp.array, poses_before: wp.array, by_all: bool
    ) -> ContactDerivatives:
        """Forces of the solver's collisions, those of ``state``, with derivatives where ``by_all``,
        in a step that began at ``before`` [m], [env_count, node_count]."""
        solver, model = self.solver, self.model
        friction = solver.friction
        motion = step_motion(model, state.positions, before, state.poses, poses_before)
        eps = None if friction is None else friction.eps_u_m
        return contact_derivatives(model, solver.collisions, motion, eps, env, by_all)

    def _wrenches(
        self, derivatives: ContactDerivatives, x: np.ndarray, poses: np.ndarray
    ) -> np.ndarray:
        """See ``MotionRecord.wrenches``, of one environment."""
        found = np.zeros((len(poses), 6))
        for tool, touched in enumerate(self.touched(derivatives)):
            forces = np.where(touched[:, :, None], derivatives.forces, 0.0)
            arms = x[derivatives.nodes] - poses[tool, :3]
            found[tool, :3] = forces.sum(axis=(0, 1))
            found[tool, 3:] = np.cross(arms, forces).sum(axis=(0, 1))
        return found

    def touched(self, derivatives: ContactDerivatives) -> list[np.ndarray]:
        """Nodes that each tool touches and that are not its own, bool, [collision, 4]."""
        bodies = self.model.surface.node_bodies.numpy()[derivatives.nodes]
        tools = self.first_kinematic + np.arange(len(self.model.kinematic))
        own = [bodies == tool for tool in tools]
        return [mine.any(axis=1, keepdims=True) & ~mine for mine in own]

    @property
    def first_kinematic(self) -> int:
        """Body id of the first kinematic body."""
        return len(self.model.scene.soft_bodies)
