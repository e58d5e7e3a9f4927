# SPDX-License-Identifier: Apache-2.0
"""Stage 1 of an iteration: the Newton direction of bodies and of the frames' remaining motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp

from taccel_lab.ipc.device.ragged_lists import ListRoom, overflows
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.motion.unknowns import begin_rhs, newton_system, newton_systems, spread_solution
from taccel_lab.model.env_rows import zero_rows
from taccel_lab.model.kinematics import turn_within
from taccel_lab.solvers.env_phase import stop
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})

_LINE_SEARCH = wp.constant(int(EnvStatus.LINE_SEARCH))
_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))
EXACT_BELOW = 0.1
"""Residual over contact force below which the matrix is not projected."""
PROJECTED_AFTER = 4
"""Iterations with projected matrices after one that was not, and was not positive definite."""
LINEAR_TOLERANCE = wp.constant(wp.float64(5.0e-3))
"""Residual over load to which a system is solved. Friction, contacts that come and go and projected
matrices leave a tenth of the residual or more in an iteration: solving until this very step would
do takes 213 CG iterations a step of ``press_2005`` in place of 156, with as many of Newton. It is
solved as well as that in the first iteration, after which smooth motion has nearly arrived, and
while frames are on their way: the load of a few stiff contacts is all that a looser solve sees
then, and the gel would not follow."""
STUCK_ABOVE = 0.7
"""Part of the residual that a whole step leaves where an exact matrix is tried."""


@wp.func
def projection(env: int, p: Progress) -> int:
    """Whether the next matrix is projected to a positive definite one (PSD_*).

    Far from the solution it has to be, or directions would lead up. Near it the projection is what
    keeps Newton's method from converging quadratically: in a gel under a press half of the elements
    have a mode that prestress makes negative, and an iteration leaves a fifth of the residual. Near
    a saddle, where a bar buckles or a gel snaps over an edge, projected matrices are so much
    stiffer than the body that whole steps hardly lower the residual.
    """
    if p.curvature.projected[env] > 0:
        p.curvature.projected[env] -= 1
        return PSD_CLAMP
    one = wp.float64(1.0)
    # A damped step (``friction_lag``) was not cut; before the first one, ``limit`` is of the start.
    cut = p.clearance.limit[env] < one or p.search.cuts[env] > 0
    if p.prescribed.progress[env] < one or (cut and p.counts.newton[env] > 0):
        return PSD_CLAMP
    near = p.rules.relative_tolerance * p.balance.excess[env] < wp.float64(EXACT_BELOW)
    stuck = p.balance.residual[env] > wp.float64(STUCK_ABOVE) * p.balance.last_residual[env]
    if near or stuck:
        return PSD_NONE
    return PSD_CLAMP


@wp.func
def element_projection(env: int, p: Progress) -> int:
    """Whether those of elements are, in a matrix that is projected.

    What prestress makes negative in an element of a gel that is held is small beside what its
    neighbours add: the whole matrix hardly ever is, and one that is not positive definite shows in
    the solve, or in a search that had to be cut. An exact element takes two thirds of the time of
    a projected one. Gels that turn and touch each other, 2 of 12 such steps, then need halves, and
    an edge that is dragged with friction takes 52 iterations in place of 33.
    """
    if p.rules.is_held == 0 or p.rules.has_friction != 0:
        return PSD_CLAMP
    if p.curvature.projected[env] > 0 or p.search.cuts[env] > 0:
        return PSD_CLAMP
    return PSD_NONE


@wp.kernel
def _aim_step_kernel(
    linear_tolerances: wp.array(dtype=wp.float64), renewed: wp.array(dtype=wp.int32), p: Progress
):
    """How far the frames try to go next, and how well the system has to be solved.

    CCD clears the chords. Over a large angle they leave the arcs far behind, and the body would
    pass what lies between; a chord that leaves its arc by more than half of the smallest gap is cut
    in any case.
    """
    env = wp.tid()
    p.prescribed.moving[env] = 0
    if p.phases.stepping[env] == 0:
        return
    p.clearance.bend[env] = wp.float64(0.0)
    p.clearance.reach[env] = p.clearance.margin[env]
    one = wp.float64(1.0)
    progress = p.prescribed.progress[env]
    goal = one
    if p.prescribed.stride[env] < one:
        goal = progress + p.prescribed.stride[env] * (one - progress)
    gap = wp.min(p.balance.min_distance[env], p.rules.dhat)
    for body in range(p.prescribed.turns.shape[1]):
        turn = wp.max(p.prescribed.turns[env, body], wp.float64(1.0e-300))
        share = turn_within(p.prescribed.radii[env, body], gap) / turn
        goal = wp.min(goal, progress + share)
    p.prescribed.goal[env] = goal
    if progress < one:
        p.prescribed.moving[env] = 1
    p.curvature.element_mode[env] = element_projection(env, p)
    p.curvature.psd_mode[env] = projection(env, p)
    if p.curvature.psd_mode[env] == PSD_NONE:
        p.curvature.element_mode[env] = PSD_NONE
    renewed[env] = 1 - p.counts.newton[env] % 2
    linear_tolerances[env] = LINEAR_TOLERANCE
    first = p.counts.newton[env] == 0 and p.roster.ahead[env] == 0
    if progress < one or first:
        whole = wp.float64(0.3) / wp.max(p.balance.excess[env], wp.float64(1.0e-300))
        linear_tolerances[env] = wp.clamp(whole, wp.float64(1.0e-6), LINEAR_TOLERANCE)
    p.balance.last_residual[env] = p.balance.residual[env]


@wp.kernel
def _count_solve_kernel(
    iterations: wp.array(dtype=wp.int32),
    breakdown: wp.array(dtype=wp.int32),
    extra: ListRoom,
    p: Progress,
):
    """Counts the solve. After a breakdown the solution still descends, unless there is none: this
    iteration stays where it is. The next ones project."""
    env = wp.tid()
    if p.phases.stepping[env] == 0:
        return
    if overflows(env, extra):
        stop(env, _CONTACT_OVERFLOW, p)
        return
    p.counts.cg[env] += iterations[env]
    p.counts.newton[env] += 1
    if breakdown[env] == 0:
        return
    if p.curvature.element_mode[env] == PSD_NONE:
        p.curvature.projected[env] = PROJECTED_AFTER
    elif iterations[env] == 0:
        stop(env, _LINE_SEARCH, p)


def assemble_and_solve(run: StepLaunches, beside: Sequence[Callable[[], None]] = ()) -> None:
    """The Newton direction of all environments that are stepping, in ``displacements``. ``beside``:
    what else may be launched meanwhile."""
    s, linear = run.s, run.s.linear
    _assemble(run, beside)
    linear.solve(run.stepping, s.config.max_cg_iterations)

    def count() -> None:
        run.decide(_count_solve_kernel, linear.iterations, linear.breakdown, linear.extra.room)

    def spread() -> None:
        # Counting may take some that stop from the mask meanwhile; nobody reads theirs.
        spread_solution(run.model, run.stepping, linear.solution, s.displacements)

    run.together([count, spread])


def _assemble(run: StepLaunches, beside: Sequence[Callable[[], None]]) -> None:
    """Matrix and right-hand side of all environments that are stepping."""
    s, p, x = run.s, run.p, run.state.positions
    active, moving = run.stepping, run.those(p.prescribed.moving)
    system = newton_system(run.model, s.linear, s.displacements)
    in_any_order = newton_systems(run.model, s.linear, s.displacements)
    bits_count = s.linear.in_any_order

    def aim() -> None:
        run.decide(_aim_step_kernel, s.linear.tolerances, s.linear.renewed)
        path = (s.start_poses, s.end_poses)
        s.frame_nodes.aim(
            active,
            moving,
            path,
            x,
            s.displacements,
            p.prescribed.goal,
            s.target_poses,
        )
        if s.joints is not None:
            s.joints.set_frames(run.state.poses, s.target_poses)

    def clear() -> None:
        zero_rows(active, s.linear.values)
        s.linear.extra.clear()
        if bits_count:
            zero_rows(active, s.linear.rhs)

    def start_rhs() -> None:
        begin_rhs(run.model, active, s.reduced, s.linear.rhs, keep=bits_count)

    def of_elements() -> None:
        for part in s.elements:
            part.write_hessians(active, x, p.curvature.element_mode)

    def of_contact(part: NewtonSystem) -> list[Callable[[], None]]:
        return s.contact.hessian_parts(active, x, part, p.curvature.psd_mode)

    def of_friction(part: NewtonSystem) -> None:
        if s.friction is not None:
            s.friction.add_hessian(active, run.motion(), part, p.curvature.sharpness)

    def of_affine() -> None:
        if s.affine is not None:
            s.affine.add_hessian(active, x, system, p.curvature.psd_mode)

    def gather() -> None:
        for part in s.elements:
            part.gather_hessians(active, system)
        for term in (s.joints, s.inertia):
            if term is not None:
                term.add_hessian(active, x, system)

    def gather_rim() -> None:
        for part in s.elements:
            part.gather_rim(moving, system)

    # What adds by atomics first; what gathers in order adds to that.
    if not bits_count:
        run.together([aim, clear, start_rhs])
        (only,) = in_any_order
        run.together([*of_contact(only), of_elements, lambda: of_friction(only), of_affine])
    else:
        run.together([aim, clear])
        measuring, adding = in_any_order
        run.together([*of_contact(measuring), of_elements, lambda: of_friction(measuring)])
        run.together([*of_contact(adding), lambda: of_friction(adding)])
        run.together([start_rhs, of_affine])
    run.together([gather, gather_rim, *beside])
