# SPDX-License-Identifier: Apache-2.0
"""One undivided step: projected Newton with CCD and line search, each environment for itself.

Kinematic bodies carry no degrees of freedom. While they are on their way to this step's target,
their remaining motion enters the right-hand side through the contact stiffness, and that of bonded
nodes on a mount through the elastic stiffness, so that the gel moves along with them; the
collision-free fraction of the common motion is taken, and the rest follows in the next iterations.
Only then does the energy have to decrease, to a force residual in newtons.

All of it is launches: what an environment does next is decided on the device (``decisions``), and
loops and branches are conditional nodes, so that the whole step can be one captured graph.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.principal import PSD_CLAMP
from taccel_lab.ipc.motion import (
    aim_prescribed,
    begin_rhs,
    measure_velocities,
    newton_system,
    reduce_gradient,
    spread_solution,
)
from taccel_lab.ipc.pair_hessian import HESSIAN_PSD
from taccel_lab.ipc.potentials.inversion import find_inversions
from taccel_lab.ipc.reduce import force_sums
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.env_rows import zero_rows
from taccel_lab.model.kinematics import place_poses_between
from taccel_lab.solvers import decisions, search_decisions
from taccel_lab.solvers.free_flight import start_in_free_flight
from taccel_lab.solvers.line_search import search_line
from taccel_lab.solvers.momentum_start import start_with_momentum
from taccel_lab.solvers.step_launches import StepLaunches


class StepRun(StepLaunches):
    """The launches of one step of the environments in ``progress.who``."""

    def run(self) -> None:
        """From the state at the start of the step to that at its end."""
        self.begin()
        self.evaluate_gradient(self.p.active)
        self.judge()
        wp.capture_while(self.p.running, self._iterate)
        self.finish()

    # Parts of a step -----------------------------------------------------------------------

    def begin(self) -> None:
        s, state, p = self.s, self.state, self.p
        p.any_turning.zero_()
        poses = [state.poses, s.end_poses, s.start_poses, s.origin_poses]
        self.decide(decisions.begin_kernel, *poses, p, self.rules)
        wp.launch(
            decisions.begin_nodes_kernel,
            dim=state.positions.shape,
            inputs=[state.positions, state.velocities, s.previous, s.origin, p],
            device=self.model.device,
        )
        self._begin_potentials()
        for part in s.elastic:
            part.add_energy(p.active, state.positions, p.before)
        if s.elastic:
            self.decide(decisions.stop_inverted_kernel, p)
        if s.invertible:
            p.inverted_before.zero_()
            find_inversions(s.invertible, p.who, state.positions, p.inverted_before)
        s.displacements.zero_()
        self.find_candidates(state.poses, p.margin)
        self.check_room(p.active, s.candidates.lists)
        self.collide(p.active, state.positions)
        self.check_room(p.active, [s.collisions])
        if s.friction is not None:
            s.friction.begin_step(p.who, s.dts)
            s.friction.lag(p.active, state.positions, s.origin)
        start_in_free_flight(self)
        start_with_momentum(self)
        self.energy(p.active, state.positions, state.poses, p.base, p.before)

    def _begin_potentials(self) -> None:
        s, state = self.s, self.state
        x = state.positions
        if s.inertia is not None:
            s.inertia.begin_step(x, state.velocities, s.dts, state.history)
        for part in s.viscosity:
            part.begin_step(x, s.dts)
        if s.joints is not None:
            s.joints.begin_step(x, state.poses, s.dts)
            wp.copy(self.p.rounding, s.joints.rounding_n)
            wp.copy(self.p.joint_energy_rounding, s.joints.rounding_j)
        if s.load is not None:
            forces, wrenches = state.loads(self.model)
            s.load.begin_step(x, forces, wrenches)

    def _iterate(self) -> None:
        self._search_direction()
        search_line(self)
        self.evaluate_gradient(self.p.active)
        self.judge()

    def finish(self) -> None:
        """Roll back what failed; velocities and joints of what converged."""
        s, state, p = self.s, self.state, self.p
        if s.silent:
            p.inverted_after.zero_()
            find_inversions(s.silent, p.who, state.positions, p.inverted_after)
        if s.inertia is not None and state.history is not None:
            least = s.config.absolute_tolerance_n
            s.inertia.find_jumps(p.body_forces, state.history, least, p.refused)
        self.decide(decisions.close_kernel, p)
        self.commit(p.chosen, s.previous, s.start_poses)
        embed_vertices(self.model, state.positions)
        if s.joints is not None:
            s.joints.end_step(p.active, state.positions)
        if s.inertia is not None:
            s.inertia.end_step(
                p.active,
                s.previous,
                state.positions,
                state.velocities,
                state.history,
                p.body_forces,
            )
        else:
            measure_velocities(p.active, s.origin, state.positions, s.dts, state.velocities)

    # Has it converged? -----------------------------------------------------------------------

    def evaluate_gradient(self, mask: wp.array) -> None:
        """Gradient, residual, contact force and smallest gap in the environments of ``mask``.

        Their collisions are those of the positions: of the start or of the trial that was taken.
        """
        s, x = self.s, self.state.positions
        wp.launch(
            decisions.begin_gradient_kernel,
            dim=s.gradient.shape,
            inputs=[mask, s.gradient, s.contact_gradient, self.p],
            device=self.model.device,
        )
        if s.joints is not None:
            s.joints.set_frames(self.state.poses)

        def of_bodies() -> None:
            for term in s.potentials.values():
                term.add_gradient(mask, x, s.gradient)

        def of_contact() -> None:
            s.contact.add_gradient(mask, x, s.contact_gradient, self.p.min_distance)

        self.together([of_bodies, of_contact, lambda: self._evaluate_friction(mask)])
        self._measure_residual(mask)

    def _evaluate_friction(self, mask: wp.array) -> None:
        s = self.s
        if s.friction is not None:
            zero_rows(mask, s.friction_gradient)
            s.friction.add_gradient(mask, self.motion(), s.friction_gradient)

    def evaluate_forces(self, mask: wp.array) -> None:
        """Contact and friction forces alone, from collisions and friction as they are."""
        s, x = self.s, self.state.positions
        zero_rows(mask, s.contact_gradient)
        s.contact.add_gradient(mask, x, s.contact_gradient, self.p.min_distance)
        self._evaluate_friction(mask)

    def _measure_residual(self, mask: wp.array) -> None:
        s, p = self.s, self.p
        gradients = [s.gradient, s.contact_gradient, s.friction_gradient]
        reduce_gradient(self.model, mask, gradients, s.reduced)
        sums = [p.body_residuals, p.body_forces]
        force_sums(mask, s.reduced, s.contact_gradient, s.body_rows, s.body_nodes, *sums)

    def judge(self) -> None:
        """Stop environments that have converged or cannot go on."""
        s, p = self.s, self.p
        s.progress.flags.zero_()
        self.decide(decisions.judge_kernel, p, self.rules)
        if s.joints is not None:
            wp.capture_if(p.closing, on_true=self._close_joints)
            self.decide(decisions.settle_kernel, p, self.rules)
        if s.friction is not None:
            wp.capture_if(p.freezing, on_true=self._refreeze_friction)
            self.decide(decisions.go_on_kernel, p, self.rules)

    def _close_joints(self) -> None:
        """Where Newton has converged, correct the joint forces until the joints are closed."""
        s, p = self.s, self.p
        assert s.joints is not None
        s.joints.update_multipliers(p.chosen, self.state.positions)
        self.decide(decisions.judge_joints_kernel, s.joints.violations, p, self.rules)
        wp.capture_if(p.reopened, on_true=self._evaluate_reopened)

    def _evaluate_reopened(self) -> None:
        self.evaluate_gradient(self.p.chosen)

    def _refreeze_friction(self) -> None:
        """Freeze friction anew in the chosen environments, and judge them by what it is then."""
        s, p = self.s, self.p
        assert s.friction is not None
        s.friction.lag(p.chosen, self.state.positions, s.origin)
        self._evaluate_friction(p.chosen)
        self._measure_residual(p.chosen)
        self.decide(decisions.judge_friction_kernel, p, self.rules)

    # The search direction --------------------------------------------------------------------

    def _search_direction(self) -> None:
        """Newton direction of bodies and remaining kinematic motion, in ``displacements``."""
        s, p, x = self.s, self.p, self.state.positions
        self.decide(search_decisions.aim_kernel, p, self.rules, s.linear.tolerances)
        place_poses_between(p.active, s.start_poses, s.end_poses, p.goal, s.target_poses)
        aim_prescribed(self.model, p.active, p.moving, x, s.target_poses, s.displacements)
        self._assemble(x)
        s.linear.solve(p.active, s.config.max_cg_iterations)
        solved = [s.linear.iterations, s.linear.breakdown, s.linear.extra.room]
        self.decide(search_decisions.count_solve_kernel, *solved, p)
        spread_solution(self.model, p.active, p.boost, s.linear.solution, s.displacements)

    def _assemble(self, x: wp.array) -> None:
        """Matrix and right-hand side of all active environments."""
        s, p = self.s, self.p
        if s.joints is not None:
            s.joints.set_frames(self.state.poses, s.target_poses)
        system = newton_system(self.model, s.linear, s.displacements)
        s.linear.values.zero_()
        s.linear.extra.clear()
        begin_rhs(self.model, p.active, s.reduced, s.linear.rhs)
        elements = [*s.elastic, *s.viscosity]

        def of_elements() -> None:
            for part in elements:
                part.write_hessians(p.active, x, PSD_CLAMP)

        def of_contact() -> None:
            s.contact.add_hessian(p.active, x, system, int(HESSIAN_PSD))

        def of_friction() -> None:
            if s.friction is not None:
                s.friction.add_hessian(p.active, self.motion(), system, p.sharpness)

        def of_affine() -> None:
            if s.affine is not None:
                s.affine.add_hessian(p.active, x, system, PSD_CLAMP)

        def gather() -> None:
            for part in elements:
                part.gather_hessians(p.active, system)
            for term in (s.joints, s.inertia):
                if term is not None:
                    term.add_hessian(p.active, x, system)

        def gather_rim() -> None:
            for part in elements:
                part.gather_rim(p.active, system)

        # What adds by atomics first; what gathers in order adds to that.
        self.together([of_contact, of_elements, of_friction, of_affine])
        self.together([gather, gather_rim])
