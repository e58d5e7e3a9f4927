# SPDX-License-Identifier: Apache-2.0
"""One step of all environments: projected Newton with CCD and line search.

Kinematic bodies carry no degrees of freedom. While they are on their way to this step's target,
their remaining motion enters the right-hand side through the contact stiffness, so that gel in
contact moves along with them; the collision-free fraction of the common motion is taken, and the
rest follows in the next iterations. Only then does the energy have to decrease, to a force
residual in newtons. Orchestration only: formulas are in ``ipc``.
"""

from __future__ import annotations

import time

import numpy as np
import warp as wp

from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.collisions import Collisions
from taccel_lab.ipc.kinematics import (
    chord_error,
    interpolate_poses,
    place_kinematic_nodes,
    turn_angle,
)
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.ipc.motion import (
    adapted_stride,
    advance_positions,
    collect_rhs,
    newton_system,
    spread_solution,
)
from taccel_lab.ipc.potentials.contact import ContactPotential
from taccel_lab.ipc.potentials.elastic import ElasticPotential
from taccel_lab.ipc.potentials.friction import FrictionPotential, StepMotion
from taccel_lab.ipc.potentials.inertia import InertiaPotential
from taccel_lab.ipc.potentials.viscosity import ViscousPotential
from taccel_lab.ipc.reduce import dot_rows
from taccel_lab.ipc.step_limit import limit_step
from taccel_lab.model import Model
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.report import EnvStatus, StepReport
from taccel_lab.state import State, as_poses


class SolverIPC:
    """Steps a model; parts that the scene does not need are not built."""

    def __init__(self, model: Model, config: SolverConfig | None = None) -> None:
        self.model = model
        self.config = config or SolverConfig()
        kappa = self.config.kappa_pa or model.scene.soft_body.material.largest_young_modulus_pa
        self.elastic = ElasticPotential(model)
        self.inertia = None if model.scene.time.quasi_static else InertiaPotential(model)
        damped = model.scene.soft_body.material.damping_time_s > 0
        self.viscosity = ViscousPotential(model) if damped else None
        self.candidates = Candidates(model)
        self.collisions = Collisions(model, kappa, self.config.dhat_m)
        self.contact = ContactPotential(model, self.collisions)
        rubs = any(body.friction > 0 for body in model.kinematic)
        self.friction = (
            FrictionPotential(model, self.collisions, self.config.friction_eps_m) if rubs else None
        )
        self.linear = LinearSystem(model.pattern, model.env_count, model.device)
        shape, device = (model.env_count, model.node_count), model.device

        def nodal() -> wp.array:
            return wp.zeros(shape, dtype=wp.vec3d, device=device)

        self._gradient, self._trial, self._previous = nodal(), nodal(), nodal()
        self._displacements, self._kinematic_target = nodal(), nodal()
        self.contact_gradient = nodal()
        """d(barrier)/dx at the end of the step [N]; the force on a node is its negative."""
        self.friction_gradient = nodal()
        """d(friction)/dx at the end of the step [N]; the force on a node is its negative."""
        self._active = wp.zeros(model.env_count, dtype=wp.int32, device=device)
        self._alphas = wp.zeros(model.env_count, dtype=wp.float64, device=device)
        self._min_distance = wp.zeros(model.env_count, dtype=wp.float64, device=device)
        self._trial_poses = wp.zeros(
            (model.env_count, len(model.kinematic)), dtype=wp.transformd, device=device
        )
        self._target_poses = wp.zeros_like(self._trial_poses)
        self._start_poses = wp.zeros_like(self._trial_poses)
        self._system = newton_system(
            model, self.linear.values, self.linear.rhs, self._displacements
        )

    def step(self, state: State, target_poses: np.ndarray | None = None) -> StepReport:
        """Advance ``state`` in place; kinematic bodies end at ``target_poses`` [env, body, 7].

        An environment that fails is rolled back to the start of the step and flagged.
        """
        started = time.perf_counter()
        run = _StepRun(self, state, target_poses)
        run.begin()
        while run.active.any():
            run.iterate()
        return run.finish(started)


class _StepRun:
    """The host-side bookkeeping of one step: who is active, how far, with which result."""

    def __init__(self, solver: SolverIPC, state: State, target_poses: np.ndarray | None) -> None:
        self.s = solver
        self.model = solver.model
        self.state = state
        self.start_poses = state.poses.numpy().reshape(self.model.env_count, -1, 7).copy()
        self.end_poses = (
            self.start_poses if target_poses is None else as_poses(self.model, target_poses)
        )
        n = self.model.env_count
        moved = np.abs(self.end_poses - self.start_poses).reshape(n, -1).max(1, initial=0.0)
        self.progress = np.where(moved > 0, 0.0, 1.0)
        self.goal = np.ones(n)
        """Progress that the next search direction aims at."""
        self.stride = np.ones(n)
        """Part of the remaining motion that it asks for, in each environment."""
        self.turning = bool((turn_angle(self.start_poses, self.end_poses) > 1e-9).any())
        self.active = np.ones(n, dtype=bool)
        self.status = np.zeros(n, dtype=np.int32)
        self.newton = np.zeros(n, dtype=np.int64)
        self.cg = np.zeros(n, dtype=np.int64)
        self.lags = np.zeros(n, dtype=np.int64)
        self.lag_change = np.full(n, np.inf)
        self.damping = np.ones(n)
        self.residual = np.full(n, np.inf)
        self.contact_force = np.zeros(n)
        self.min_distance = np.full(n, np.inf)
        self.smallest_step = np.ones(n)

    # Parts of a step -----------------------------------------------------------------------

    def begin(self) -> None:
        s, state = self.s, self.state
        wp.copy(s._previous, state.positions)
        wp.copy(s._start_poses, state.poses)
        self._push_active()
        if s.inertia is not None:
            s.inertia.begin_step(state.positions, state.velocities)
        if s.viscosity is not None:
            s.viscosity.begin_step(state.positions)
        s._displacements.zero_()
        s.candidates.update(
            s._active, state.positions, s._displacements, state.poses, state.poses, s.config.dhat_m
        )
        if s.friction is not None:
            s.collisions.update(s._active, state.positions, s.candidates)
            s.friction.clear()
            s.friction.lag(s._active, state.positions)

    def iterate(self) -> None:
        self._push_active()
        self._evaluate_gradient()
        self._judge()
        if not self.active.any():
            return
        self._push_active()
        self._search_direction()
        self._line_search()

    def finish(self, started: float) -> StepReport:
        """Roll back what failed, read the forces and report; ``started`` on the step's clock."""
        s = self.s
        failed = self.status != EnvStatus.CONVERGED
        if failed.any():
            positions, previous = self.state.positions.numpy(), s._previous.numpy()
            positions[failed] = previous[failed]
            poses = self.state.poses.numpy().reshape(self.start_poses.shape)
            poses[failed] = self.start_poses[failed]
            self.state.positions.assign(positions)
            self.state.poses.assign(poses.reshape(self.state.poses.shape + (7,)))
        self._evaluate_outputs()
        if s.inertia is not None:
            dt = self.model.scene.time.dt_s
            velocities = (self.state.positions.numpy() - s._previous.numpy()) / dt
            velocities[failed] = self.state.velocities.numpy()[failed]
            self.state.velocities.assign(velocities)
        return StepReport(
            status=self.status,
            newton_iterations=self.newton,
            cg_iterations=self.cg,
            friction_lags=self.lags,
            residual_n=self.residual,
            contact_force_n=self.contact_force,
            min_distance_m=self.min_distance,
            smallest_step=self.smallest_step,
            seconds=time.perf_counter() - started,
        )

    def _evaluate_outputs(self) -> None:
        """Contact and friction forces of all environments at the positions they ended at."""
        s, x = self.s, self.state.positions
        s._active.fill_(1)
        s._displacements.zero_()
        s.candidates.update(
            s._active, x, s._displacements, self.state.poses, self.state.poses, s.config.dhat_m
        )
        s.collisions.update(s._active, x, s.candidates)
        s.contact_gradient.zero_()
        s.contact.add_gradient(s._active, x, s.contact_gradient, s._min_distance)
        s.friction_gradient.zero_()
        if s.friction is not None:
            s.friction.add_gradient(s._active, self._motion(), s.friction_gradient)

    # Newton iteration ----------------------------------------------------------------------

    def _motion(
        self, positions: wp.array | None = None, poses: wp.array | None = None
    ) -> StepMotion:
        """Motion since the start of the step, to the state or to a trial."""
        s, state = self.s, self.state
        assert s.friction is not None
        return s.friction.motion(
            state.positions if positions is None else positions,
            s._previous,
            state.poses if poses is None else poses,
            s._start_poses,
        )

    def _push_active(self) -> None:
        self.s._active.assign(self.active.astype(np.int32))

    def _evaluate_gradient(self) -> None:
        """Gradient, residual, contact force and minimum distance of the active environments."""
        s, x = self.s, self.state.positions
        s.collisions.update(s._active, x, s.candidates)
        s._gradient.zero_()
        s.contact_gradient.zero_()
        s._min_distance.fill_(np.inf)
        s.elastic.add_gradient(s._active, x, s._gradient)
        if s.inertia is not None:
            s.inertia.add_gradient(s._active, x, s._gradient)
        if s.viscosity is not None:
            s.viscosity.add_gradient(s._active, x, s._gradient)
        s.contact.add_gradient(s._active, x, s.contact_gradient, s._min_distance)
        self._measure_residual()

    def _measure_residual(self) -> None:
        s, a = self.s, self.active
        s.friction_gradient.zero_()
        if s.friction is not None:
            s.friction.add_gradient(s._active, self._motion(), s.friction_gradient)
        contact = s.contact_gradient.numpy()
        total = s._gradient.numpy() + contact + s.friction_gradient.numpy()
        free = self.model.free_nodes.numpy()
        self.residual[a] = np.sqrt(dot_rows(total[a][:, free], total[a][:, free]))
        on_gel = contact[a][:, : self.model.soft_count]
        self.contact_force[a] = np.linalg.norm(on_gel, axis=-1).sum(axis=1)
        self.min_distance[a] = s._min_distance.numpy()[a]

    def _tolerance(self) -> np.ndarray:
        c = self.s.config
        return np.maximum(c.absolute_tolerance_n, c.relative_tolerance * self.contact_force)

    def _judge(self) -> None:
        """Freeze environments that have converged or cannot go on."""
        s = self.s
        bad = self.active & ~np.isfinite(self.residual)
        self._stop(bad, EnvStatus.NOT_A_NUMBER)
        settled = self.active & (self.progress >= 1)
        if s.friction is None:
            self._stop(settled & (self.residual <= self._tolerance()), EnvStatus.CONVERGED)
        else:
            # While freezing anew still changes forces, solving in between to the last digit is
            # wasted: a tenth of the last change is enough, and one step when damped.
            good_enough = self.residual <= np.maximum(self._tolerance(), 0.1 * self.lag_change)
            settled &= good_enough | (self.damping < 1)
            if settled.any():
                self._refreeze_friction(settled)
        self._stop(
            self.active & (self.newton >= s.config.max_newton_iterations),
            EnvStatus.NO_CONVERGENCE,
        )

    def _refreeze_friction(self, who: np.ndarray) -> None:
        """Freeze friction anew; only the residual with the new values counts as converged."""
        s = self.s
        assert s.friction is not None
        everyone, self.active = self.active, who
        s._active.assign(who.astype(np.int32))
        s.friction.lag(s._active, self.state.positions)
        self.lags[who] += 1
        self._measure_residual()
        done = who & (self.residual <= self._tolerance())
        # Freezing is a fixed-point iteration. Where it alternates instead of shrinking (a node
        # leaning on two faces in turn) the steps between are damped until it shrinks again.
        grows = who & (self.residual > (1.0 - 0.1 * self.damping) * self.lag_change)
        shrinks = who & ~grows
        self.damping[grows] = np.maximum(0.5 * self.damping[grows], 0.05)
        self.damping[shrinks] = np.minimum(1.5 * self.damping[shrinks], 1.0)
        self.lag_change[who] = self.residual[who]
        self.active = everyone
        self._stop(done, EnvStatus.CONVERGED)
        self._stop(
            self.active & who & (self.lags >= s.config.max_friction_lags), EnvStatus.FRICTION
        )
        # The measurement covered only those frozen anew: restore the gradient of all.
        self._push_active()
        self._measure_residual()

    def _stop(self, who: np.ndarray, status: EnvStatus) -> None:
        self.status[who] = status
        self.active &= ~who

    def _search_direction(self) -> None:
        """Newton direction of gel and remaining kinematic motion, in ``_displacements``."""
        s, x = self.s, self.state.positions
        s.elastic.set_hessian(s._active, x, s.linear.values, s.config.element_projection.code)
        if s.inertia is not None:
            s.inertia.add_hessian(s._active, s.linear.values)
        if s.viscosity is not None:
            mode = s.config.element_projection.code
            s.viscosity.add_hessian(s._active, x, s.linear.values, mode)
        self._aim()
        moving = wp.array(
            (self.active & (self.progress < 1)).astype(np.int32), device=self.model.device
        )
        collect_rhs(
            self.model,
            s._active,
            moving,
            [s._gradient, s.contact_gradient, s.friction_gradient],
            x,
            s._kinematic_target,
            s.linear.rhs,
            s._displacements,
        )
        s.contact.add_hessian(s._active, x, s._system, s.config.contact_hessian_mode)
        if s.friction is not None:
            s.friction.add_hessian(s._active, self._motion(), s._system)
        solved = s.linear.solve(s._active, self._forcing_terms(), s.config.max_cg_iterations)
        self.cg += solved.iterations
        self.newton[self.active] += 1
        # After a breakdown the last iterate still descends, unless there is none.
        self._stop(solved.breakdown & (solved.iterations == 0), EnvStatus.NOT_A_NUMBER)
        spread_solution(self.model, s._active, s.linear.solution, s._displacements)

    def _aim(self) -> None:
        """Where the kinematic bodies try to go next: a stride along the remaining motion."""
        s = self.s
        self.goal = np.where(
            self.stride < 1, self.progress + self.stride * (1 - self.progress), 1.0
        )
        poses = interpolate_poses(self.start_poses, self.end_poses, self.goal)
        s._target_poses.assign(poses.reshape(s._target_poses.shape + (7,)))
        wp.copy(s._kinematic_target, self.state.positions)
        place_kinematic_nodes(self.model, s._target_poses, s._kinematic_target)

    def _forcing_terms(self) -> np.ndarray:
        """Relative CG tolerances: what it takes to converge with this very step, at most 0.01.

        Looser solves far from the solution, as in [Eisenstat and Walker 1996], cost more in Newton
        iterations than they save in CG, and at 0.1 the gel no longer follows the body.
        """
        ratios = self._tolerance() / np.maximum(self.residual, 1e-300)
        return np.clip(0.3 * ratios, 1e-6, 1e-2)

    def _line_search(self) -> None:
        s, state = self.s, self.state
        margin = s.config.dhat_m
        if self.turning:
            radii = np.array([body.radius_m for body in self.model.kinematic])
            margin += chord_error(self.start_poses, self.end_poses, radii)
        s.candidates.update(
            s._active, state.positions, s._displacements, state.poses, s._target_poses, margin
        )
        limit_step(
            self.model, s._active, s.candidates, state.positions, s._displacements, s._alphas
        )
        alpha = np.minimum(s._alphas.numpy(), self.damping)
        gradient = s._gradient.numpy() + s.contact_gradient.numpy() + s.friction_gradient.numpy()
        slope = dot_rows(gradient, s._displacements.numpy())
        s.collisions.update(s._active, state.positions, s.candidates)
        before = self._energy(state.positions, state.poses)
        settled = self.progress >= 1
        waiting = self.active.copy()
        for _ in range(s.config.max_line_search_cuts):
            progress = self._trial(alpha)
            s._active.assign(waiting.astype(np.int32))
            safe = self._rotation_is_safe(waiting)
            s.collisions.update(s._active, s._trial, s.candidates)
            after = self._energy(s._trial, s._trial_poses)
            # Sums of that many terms carry rounding of about 1e-14 of the energy.
            enough = before + 1e-4 * alpha * np.minimum(slope, 0) + 1e-13 * np.abs(before)
            good = waiting & safe & np.isfinite(after) & (~settled | (after <= enough))
            waiting &= ~good
            if not waiting.any():
                break
            alpha[waiting] *= 0.5
        moved = self.active & ~waiting
        progress = np.where(moved, progress, self.progress)
        self._stop(waiting, EnvStatus.LINE_SEARCH)
        self.smallest_step[moved] = np.minimum(self.smallest_step[moved], alpha[moved])
        s._active.assign(moved.astype(np.int32))
        alpha[~moved] = 0.0
        self._trial(alpha)
        self.progress = progress
        self.stride[moved] = adapted_stride(self.stride, alpha)[moved]
        wp.copy(state.positions, s._trial)
        wp.copy(state.poses, s._trial_poses)

    def _trial(self, alpha: np.ndarray) -> np.ndarray:
        """Positions and poses after a fraction of the direction; returns the new progress."""
        s = self.s
        progress = self.progress + alpha * (self.goal - self.progress)
        progress[progress > 1 - 1e-12] = 1.0
        poses = interpolate_poses(self.start_poses, self.end_poses, progress)
        s._trial_poses.assign(poses.reshape(s._trial_poses.shape + (7,)))
        s._alphas.assign(alpha)
        advance_positions(self.state.positions, s._displacements, s._alphas, s._trial)
        place_kinematic_nodes(self.model, s._trial_poses, s._trial)
        return progress

    def _rotation_is_safe(self, who: np.ndarray) -> np.ndarray:
        """A body that turns leaves the chord that CCD checked: check the path really taken."""
        s = self.s
        if not self.turning:
            return np.ones(len(who), dtype=bool)
        path = wp.array(
            s._trial.numpy() - self.state.positions.numpy(),
            dtype=wp.vec3d,
            device=self.model.device,
        )
        limits = wp.zeros(len(who), dtype=wp.float64, device=self.model.device)
        limit_step(self.model, s._active, s.candidates, self.state.positions, path, limits)
        return limits.numpy() >= 1.0

    def _energy(self, positions: wp.array, poses: wp.array) -> np.ndarray:
        """Total potential of the environments flagged in ``_active`` [J], shape [env_count]."""
        s = self.s
        total = s.elastic.energy(s._active, positions) + s.contact.energy(s._active, positions)
        if s.inertia is not None:
            total += s.inertia.energy(s._active, positions)
        if s.viscosity is not None:
            total += s.viscosity.energy(s._active, positions)
        if s.friction is not None:
            total += s.friction.energy(s._active, self._motion(positions, poses))
        return total
