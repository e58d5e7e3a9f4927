# SPDX-License-Identifier: Apache-2.0
"""Stage 1 of an iteration: the Newton direction of bodies and of the frames' remaining motion."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.capacity import ListRoom, overflows
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP
from taccel_lab.ipc.motion import aim_prescribed, begin_rhs, newton_system, spread_solution
from taccel_lab.ipc.pair_hessian import HESSIAN_PSD
from taccel_lab.model.kinematics import place_poses_between, turn_within
from taccel_lab.solvers.env_phase import stop
from taccel_lab.solvers.env_progress import EnvProgress, Rules
from taccel_lab.solvers.report import EnvStatus
from taccel_lab.solvers.step_launches import StepLaunches

wp.set_module_options({"enable_backward": False})

_LINE_SEARCH = wp.constant(int(EnvStatus.LINE_SEARCH))
_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))
LARGEST_BOOST = 64.0
"""Longest step along Newton's direction."""


@wp.func
def boosted(env: int, p: EnvProgress) -> wp.float64:
    """Four times the last multiple after a full step that hardly lowered the residual, else one.

    Near a saddle, where a gel snaps over an edge, the projected matrix is stiffer than the body:
    whole steps go on for dozens of iterations and each takes the same small part of the way.
    """
    one = wp.float64(1.0)
    if p.progress[env] < one or p.damping[env] < one:
        return one
    ratio = p.excess[env] / p.last_excess[env]
    if ratio < wp.float64(0.7) or ratio > wp.float64(2.0):
        return one
    if p.cuts[env] > 0 or p.alpha[env] < one or p.last_excess[env] == wp.float64(wp.inf):
        return one
    return wp.min(wp.float64(4.0) * p.boost[env], wp.float64(LARGEST_BOOST))


@wp.kernel
def _aim_kernel(p: EnvProgress, r: Rules, linear_tolerances: wp.array(dtype=wp.float64)):
    """How far the frames try to go next, and how well the system has to be solved.

    CCD clears the chords. Over a large angle they leave the arcs far behind, and the body would
    pass what lies between; a chord that leaves its arc by more than half of the smallest gap is cut
    in any case.

    The relative tolerance of CG is what it takes to converge with this very step, at most 0.01:
    looser solves far from the solution, as in [Eisenstat and Walker 1996], cost more in Newton
    iterations than they save in CG, and at 0.1 the gel no longer follows the body.
    """
    env = wp.tid()
    if env == 0:
        p.rounds[0] += 1
        p.searching[0] = 0
        p.any_curved[0] = p.any_turning[0]
    p.moving[env] = 0
    p.bend[env] = wp.float64(0.0)
    p.reach[env] = p.margin[env]
    if p.active[env] == 0:
        return
    one = wp.float64(1.0)
    progress = p.progress[env]
    goal = one
    if p.stride[env] < one:
        goal = progress + p.stride[env] * (one - progress)
    gap = wp.min(p.min_distance[env], r.dhat)
    for body in range(p.turns.shape[1]):
        turn = wp.max(p.turns[env, body], wp.float64(1.0e-300))
        share = turn_within(p.radii[env, body], gap) / turn
        goal = wp.min(goal, progress + share)
    p.goal[env] = goal
    if progress < one:
        p.moving[env] = 1
    p.boost[env] = boosted(env, p)
    p.last_excess[env] = p.excess[env]
    ratio = one / wp.max(p.excess[env], wp.float64(1.0e-300))
    linear_tolerances[env] = wp.clamp(
        wp.float64(0.3) * ratio, wp.float64(1.0e-6), wp.float64(1.0e-2)
    )


@wp.kernel
def _count_solve_kernel(
    iterations: wp.array(dtype=wp.int32),
    breakdown: wp.array(dtype=wp.int32),
    extra: ListRoom,
    p: EnvProgress,
):
    """After a breakdown the last iterate still descends, unless there is none."""
    env = wp.tid()
    if p.active[env] == 0:
        return
    if overflows(env, extra):
        stop(env, _CONTACT_OVERFLOW, p)
        return
    p.cg[env] += iterations[env]
    p.newton[env] += 1
    if breakdown[env] != 0 and iterations[env] == 0:
        stop(env, _LINE_SEARCH, p)


def assemble_and_solve(run: StepLaunches) -> None:
    """The Newton direction of all active environments, in ``displacements``."""
    s, p, x = run.s, run.p, run.state.positions
    run.decide(_aim_kernel, p, run.rules, s.linear.tolerances)
    place_poses_between(p.active, s.start_poses, s.end_poses, p.goal, s.target_poses)
    aim_prescribed(run.model, p.active, p.moving, x, s.target_poses, s.displacements)
    _assemble(run)
    s.linear.solve(p.active, s.config.max_cg_iterations)
    solved = [s.linear.iterations, s.linear.breakdown, s.linear.extra.room]
    run.decide(_count_solve_kernel, *solved, p)
    spread_solution(run.model, p.active, p.boost, s.linear.solution, s.displacements)


def _assemble(run: StepLaunches) -> None:
    """Matrix and right-hand side of all active environments."""
    s, p, x = run.s, run.p, run.state.positions
    if s.joints is not None:
        s.joints.set_frames(run.state.poses, s.target_poses)
    system = newton_system(run.model, s.linear, s.displacements)
    s.linear.values.zero_()
    s.linear.extra.clear()
    begin_rhs(run.model, p.active, s.reduced, s.linear.rhs)
    elements = [*s.elastic, *s.viscosity]

    def of_elements() -> None:
        for part in elements:
            part.write_hessians(p.active, x, PSD_CLAMP)

    def of_contact() -> None:
        s.contact.add_hessian(p.active, x, system, int(HESSIAN_PSD))

    def of_friction() -> None:
        if s.friction is not None:
            s.friction.add_hessian(p.active, run.motion(), system, p.sharpness)

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
            part.gather_rim(p.moving, system)

    # What adds by atomics first; what gathers in order adds to that.
    run.together([of_contact, of_elements, of_friction, of_affine])
    run.together([gather, gather_rim])
