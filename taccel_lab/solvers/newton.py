# SPDX-License-Identifier: Apache-2.0
"""One undivided step: projected Newton with CCD and line search, each environment for itself.

Kinematic bodies carry no degrees of freedom. While they are on their way to this step's target,
their remaining motion enters the right-hand side through the contact stiffness, and that of bonded
nodes on a mount through the elastic stiffness, so that the gel moves along with them; the
collision-free fraction of the common motion is taken, and the rest follows in the next iterations.
Only then does the energy have to decrease, to a force residual in newtons.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from taccel_lab.ipc.affine.embedding import embed_vertices
from taccel_lab.ipc.kinematics import (
    interpolate_poses,
    place_kinematic_nodes,
    turn_angle,
)
from taccel_lab.ipc.motion import (
    aim_prescribed,
    begin_rhs,
    copy_rows,
    newton_system,
    reduce_gradient,
    spread_solution,
)
from taccel_lab.ipc.potentials.external import ExternalLoad
from taccel_lab.ipc.potentials.friction import StepMotion
from taccel_lab.ipc.reduce import dot_rows
from taccel_lab.solvers.free_flight import start_in_free_flight
from taccel_lab.solvers.line_search import search_line
from taccel_lab.solvers.report import EnvStatus, StepReport
from taccel_lab.state import State

if TYPE_CHECKING:
    from taccel_lab.solvers.solver_ipc import SolverIPC


class StepRun:
    """The host-side bookkeeping of one step: who is active, how far, with which result."""

    def __init__(
        self, solver: SolverIPC, state: State, end_poses: np.ndarray, who: np.ndarray
    ) -> None:
        self.s = solver
        self.model = solver.model
        self.state = state
        self.start_poses = state.poses.numpy().reshape(self.model.env_count, -1, 7).copy()
        self.end_poses = end_poses
        self.who = who.copy()
        n = self.model.env_count
        moved = np.abs(self.end_poses - self.start_poses).reshape(n, -1).max(1, initial=0.0)
        self.progress = np.where(who & (moved > 0), 0.0, 1.0)
        self.goal = np.ones(n)
        """Progress that the next search direction aims at."""
        self.stride = np.ones(n)
        """Part of the remaining motion that it asks for, in each environment."""
        self.turns = np.where(who[:, None], turn_angle(self.start_poses, self.end_poses), 0.0)
        """Angle by which each kinematic body turns in this step [rad], [env_count, kinematic]."""
        self.turning = (self.turns > 1e-9).any(axis=1)
        self.active = who.copy()
        self.status = np.where(who, EnvStatus.RUNNING, EnvStatus.SKIPPED).astype(np.int32)
        self.newton = np.zeros(n, dtype=np.int64)
        self.cg = np.zeros(n, dtype=np.int64)
        self.lags = np.zeros(n, dtype=np.int64)
        self.joint_rounds = np.zeros(n, dtype=np.int64)
        self.lag_change = np.full(n, np.inf)
        self.damping = np.ones(n)
        self.residual = np.full(n, np.inf)
        self.contact_force = np.zeros(n)
        self.min_distance = np.full(n, np.inf)
        self.violation = np.zeros(n)
        self.smallest_step = np.ones(n)

    # Parts of a step -----------------------------------------------------------------------

    def begin(self) -> None:
        s, state = self.s, self.state
        self.push_active()
        copy_rows(s.active, state.positions, s.previous)
        start = s.start_poses.numpy().reshape(self.start_poses.shape)
        start[self.who] = self.start_poses[self.who]
        s.start_poses.assign(start.reshape(s.start_poses.shape + (7,)))
        self._begin_potentials()
        finite = np.isfinite(state.positions.numpy()).all(axis=(1, 2))
        finite &= np.isfinite(state.velocities.numpy()).all(axis=(1, 2))
        self.stop(self.active & ~finite, EnvStatus.NOT_A_NUMBER)
        self.push_active()
        for part in s.elastic:
            inverted = np.isinf(part.energy(s.active, state.positions))
            self.stop(self.active & inverted, EnvStatus.INVERSION)
        self.push_active()
        s.displacements.zero_()
        self.find_candidates(state.poses, s.config.dhat_m)
        if s.friction is not None:
            self.collide(state.positions)
            s.friction.clear(self.who)
            s.friction.lag(s.active, state.positions)
        start_in_free_flight(self)

    def _begin_potentials(self) -> None:
        s, state = self.s, self.state
        x = state.positions
        if s.inertia is not None:
            s.inertia.begin_step(x, state.velocities, s.dts, state.history)
        for part in s.viscosity:
            part.begin_step(x, s.dts)
        if s.joints is not None:
            s.joints.begin_step(x, state.poses, s.dts)
        loaded = state.external_forces is not None or state.wrenches is not None
        if loaded and s.load is None:
            s.load = ExternalLoad(self.model)
        if s.load is not None:
            forces, wrenches = state.loads(self.model)
            s.load.begin_step(x, forces, wrenches)

    def iterate(self) -> None:
        self.push_active()
        self._evaluate_gradient()
        self._judge()
        if not self.active.any():
            return
        self.push_active()
        self._search_direction()
        search_line(self)

    def finish(self) -> StepReport:
        """Roll back what failed and report."""
        s, state = self.s, self.state
        failed = self.who & (self.status != EnvStatus.CONVERGED)
        if failed.any():
            s.active.assign(failed.astype(np.int32))
            copy_rows(s.active, s.previous, state.positions)
            poses = state.poses.numpy().reshape(self.start_poses.shape)
            poses[failed] = self.start_poses[failed]
            state.poses.assign(poses.reshape(state.poses.shape + (7,)))
        done = self.who & ~failed
        s.active.assign(done.astype(np.int32))
        embed_vertices(self.model, state.positions)
        if s.joints is not None:
            s.joints.end_step(s.active, state.positions)
        if s.inertia is not None:
            s.inertia.end_step(
                s.active, s.previous, state.positions, state.velocities, state.history
            )
        return StepReport(
            status=self.status,
            newton_iterations=self.newton,
            cg_iterations=self.cg,
            friction_lags=self.lags,
            residual_n=self.residual,
            contact_force_n=self.contact_force,
            min_distance_m=self.min_distance,
            smallest_step=self.smallest_step,
            joint_violation_m=self.violation,
            substeps=done.astype(np.int64),
            seconds=0.0,
        )

    # Newton iteration ----------------------------------------------------------------------

    def _motion(
        self, positions: wp.array | None = None, poses: wp.array | None = None
    ) -> StepMotion:
        """Motion since the start of the step, to the state or to a trial."""
        s, state = self.s, self.state
        assert s.friction is not None
        return s.friction.motion(
            state.positions if positions is None else positions,
            s.previous,
            state.poses if poses is None else poses,
            s.start_poses,
        )

    def push_active(self) -> None:
        self.s.active.assign(self.active.astype(np.int32))

    def find_candidates(self, poses: wp.array, margin: float) -> None:
        """Pairs near the way of ``displacements`` and of the frames to ``poses``."""
        s, state = self.s, self.state
        s.candidates.update(s.active, state.positions, s.displacements, state.poses, poses, margin)
        self._drop(s.candidates.overflowed)

    def collide(self, positions: wp.array) -> None:
        """Collisions at ``positions``, for the environments flagged in the solver's ``active``."""
        self.s.collisions.update(self.s.active, positions, self.s.candidates)
        self._drop(self.s.collisions.overflowed)

    def _drop(self, overflowed: np.ndarray) -> None:
        """Give up environments with too many contacts."""
        if (self.active & overflowed).any():
            self.stop(self.active & overflowed, EnvStatus.CONTACT_OVERFLOW)
            kept = self.s.active.numpy() * self.active
            self.s.active.assign(kept.astype(np.int32))

    def _evaluate_gradient(self) -> None:
        """Gradient, residual, contact force and minimum distance of the active environments."""
        s, x = self.s, self.state.positions
        self.collide(x)
        s.gradient.zero_()
        s.contact_gradient.zero_()
        s.min_distance.fill_(np.inf)
        if s.joints is not None:
            s.joints.set_frames(self.state.poses)
        for term in s.potentials.values():
            term.add_gradient(s.active, x, s.gradient)
        s.contact.add_gradient(s.active, x, s.contact_gradient, s.min_distance)
        self._measure_residual()

    def _measure_residual(self) -> None:
        s, a = self.s, self.active
        s.friction_gradient.zero_()
        if s.friction is not None:
            s.friction.add_gradient(s.active, self._motion(), s.friction_gradient)
        gradients = [s.gradient, s.contact_gradient, s.friction_gradient]
        reduce_gradient(self.model, s.active, gradients, s.reduced)
        reduced = s.reduced.numpy()[a]
        self.residual[a] = np.sqrt(dot_rows(reduced, reduced))
        # Action and reaction: half of the sum over both sides of all contacts.
        contact = np.linalg.norm(s.contact_gradient.numpy()[a], axis=-1)
        self.contact_force[a] = 0.5 * contact.sum(axis=1)
        self.min_distance[a] = s.min_distance.numpy()[a]

    def _tolerance(self) -> np.ndarray:
        c = self.s.config
        force = np.maximum(c.absolute_tolerance_n, c.relative_tolerance * self.contact_force)
        return np.maximum(force, self.s.rounding_n)

    def _judge(self) -> None:
        """Freeze environments that have converged or cannot go on."""
        s = self.s
        self.stop(self.active & ~(self.min_distance > 0), EnvStatus.TOUCHING)
        self.stop(self.active & ~np.isfinite(self.residual), EnvStatus.NOT_A_NUMBER)
        settled = self.active & (self.progress >= 1)
        if s.joints is not None:
            settled = self._close_joints(settled)
        if s.friction is None:
            self.stop(settled & (self.residual <= self._tolerance()), EnvStatus.CONVERGED)
        else:
            # While freezing anew still changes forces, solving in between to the last digit is
            # wasted: a tenth of the last change is enough, and one step when damped.
            good_enough = self.residual <= np.maximum(self._tolerance(), 0.1 * self.lag_change)
            settled &= good_enough | (self.damping < 1)
            if settled.any():
                self._refreeze_friction(settled)
        self.stop(
            self.active & (self.newton >= s.config.max_newton_iterations),
            EnvStatus.NO_CONVERGENCE,
        )

    def _close_joints(self, settled: np.ndarray) -> np.ndarray:
        """Where Newton has converged, correct the joint forces until the joints are closed.

        Returns those of ``settled`` whose joints are.
        """
        s = self.s
        assert s.joints is not None
        solved = settled & (self.residual <= self._tolerance())
        if not solved.any():
            return settled
        s.active.assign(solved.astype(np.int32))
        violation = s.joints.update_multipliers(s.active, self.state.positions)
        self.violation[solved] = violation[solved]
        is_open = solved & (violation > s.joints.tolerance_m)
        self.joint_rounds[is_open] += 1
        self.stop(is_open & (self.joint_rounds > s.config.max_joint_rounds), EnvStatus.JOINT)
        self.push_active()
        if (is_open & self.active).any():
            self._evaluate_gradient()
        return settled & ~is_open

    def _refreeze_friction(self, who: np.ndarray) -> None:
        """Freeze friction anew; only the residual with the new values counts as converged."""
        s = self.s
        assert s.friction is not None
        everyone, self.active = self.active, who
        s.active.assign(who.astype(np.int32))
        s.friction.lag(s.active, self.state.positions)
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
        self.stop(done, EnvStatus.CONVERGED)
        self.stop(self.active & who & (self.lags >= s.config.max_friction_lags), EnvStatus.FRICTION)
        # The measurement covered only those frozen anew: restore the gradient of all.
        self.push_active()
        self._measure_residual()

    def stop(self, who: np.ndarray, status: EnvStatus) -> None:
        """End the step of the environments ``who`` with a status."""
        self.status[who] = status
        self.active &= ~who

    def _search_direction(self) -> None:
        """Newton direction of bodies and remaining kinematic motion, in ``displacements``."""
        s, x = self.s, self.state.positions
        self._aim()
        moving = wp.array(
            (self.active & (self.progress < 1)).astype(np.int32), device=self.model.device
        )
        aim_prescribed(self.model, moving, x, s.frame_targets, s.displacements)
        self._assemble(x)
        solved = s.linear.solve(s.active, self._forcing_terms(), s.config.max_cg_iterations)
        self.cg += solved.iterations
        self.newton[self.active] += 1
        # After a breakdown the last iterate still descends, unless there is none.
        self.stop(solved.breakdown & (solved.iterations == 0), EnvStatus.NOT_A_NUMBER)
        spread_solution(self.model, s.active, s.linear.solution, s.displacements)

    def _assemble(self, x: wp.array) -> None:
        """Matrix and right-hand side of all active environments."""
        s = self.s
        mode = s.config.element_projection.code
        if s.joints is not None:
            s.joints.set_frames(self.state.poses, s.target_poses)
        while True:
            system = newton_system(self.model, s.linear, s.displacements)
            s.linear.values.zero_()
            s.linear.extra.clear()
            begin_rhs(self.model, s.active, s.reduced, s.linear.rhs)
            for term in s.potentials.values():
                term.add_hessian(s.active, x, system, mode)
            s.contact.add_hessian(s.active, x, system, s.config.contact_hessian_mode)
            if s.friction is not None:
                s.friction.add_hessian(s.active, self._motion(), system)
            # When the list of extra blocks was too short, it has grown now.
            if not s.linear.extra.overflowed():
                return

    def _aim(self) -> None:
        """Where the kinematic bodies try to go next: a stride along the remaining motion."""
        s = self.s
        self.goal = np.where(
            self.stride < 1, self.progress + self.stride * (1 - self.progress), 1.0
        )
        self.goal = np.minimum(self.goal, self.progress + self._largest_turn())
        poses = interpolate_poses(self.start_poses, self.end_poses, self.goal)
        s.target_poses.assign(poses.reshape(s.target_poses.shape + (7,)))
        wp.copy(s.frame_targets, self.state.positions)
        place_kinematic_nodes(self.model, s.target_poses, s.frame_targets)

    def _largest_turn(self) -> np.ndarray:
        """Part of the step in which no arc leaves its chord by more than half of the smallest gap.

        CCD clears the chords. Over a large angle they leave the arcs far behind, and the body would
        pass what lies between; a chord that leaves its arc by a gap is cut in any case.
        """
        radii = np.maximum(self.model.kinematic_radii_m, 1e-300)
        gap = np.minimum(self.min_distance, self.s.config.dhat_m)[:, None]
        angle = 2 * np.arccos(np.clip(1 - 0.5 * gap / radii, -1, 1))
        return (angle / np.maximum(self.turns, 1e-300)).min(axis=1, initial=np.inf)

    def _forcing_terms(self) -> np.ndarray:
        """Relative CG tolerances: what it takes to converge with this very step, at most 0.01.

        Looser solves far from the solution, as in [Eisenstat and Walker 1996], cost more in Newton
        iterations than they save in CG, and at 0.1 the gel no longer follows the body.
        """
        ratios = self._tolerance() / np.maximum(self.residual, 1e-300)
        return np.clip(0.3 * ratios, 1e-6, 1e-2)

    def energy(self, positions: wp.array, poses: wp.array) -> np.ndarray:
        """Total potential of the environments flagged in ``active`` [J], shape [env_count]."""
        s = self.s
        if s.joints is not None:
            s.joints.set_frames(poses)
        total = s.contact.energy(s.active, positions)
        for term in s.potentials.values():
            total = total + term.energy(s.active, positions)
        if s.friction is not None:
            total += s.friction.energy(s.active, self._motion(positions, poses))
        return total
