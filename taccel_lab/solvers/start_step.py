# SPDX-License-Identifier: Apache-2.0
"""Where Newton's method starts: where everything would be if nothing changed, if it can get there.

- Where frames move as they did in the last step, all goes on at its last velocity: in a steady
  motion, a grasp that is carried or a gel that is dragged, that is all but the answer, and one
  Newton iteration in three is saved.
- Where the caller knows about where a gel will be (``SolverIPC.step``), it is there.
- An affine body that touches nothing and turns is placed where free flight leads it, with its
  joints closed: straight steps have to follow the curved set of rotations in short pieces, and a
  body of 1 GPa that turns by 0.04 a step takes 16 of them.

The start is taken where nothing is in the way of anything, and where it is free flight alone, where
it lowers the energy. Else Newton starts from where the bodies are, and takes the frames along.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.affine.rigidity import predict_affine, ride_along
from taccel_lab.ipc.device.ragged_lists import ListRoom, overflows
from taccel_lab.ipc.motion.unknowns import coast, keep_steady, subtract_rows
from taccel_lab.ipc.potentials.energy import sum_energies
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.env_rows import copy_rows, zero_rows
from taccel_lab.model.launches import launch
from taccel_lab.solvers.env_phase import STARTING, STAYING, enter, leave, stop
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.limit_step import find_pairs, limit_step
from taccel_lab.solvers.search_line import begin_trial, evaluate_trial, place_trial
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})

_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))
_LARGEST_CHANGE = 0.5
"""Change of the frames' way from one step to the next up to which they move steadily."""
_SMALL_TURN_SQ = 1e-6
"""Angle squared below which straight steps are as good as free flight."""


@wp.kernel
def _choose_momentum_kernel(p: Progress):
    """Choose the environments whose frames have yet to move; not in a step that is taken again,
    which has had its momentum."""
    env = wp.tid()
    if env == 0:
        p.flags.any_flight[0] = 0
    fresh = p.phases.fresh[env] != 0 and p.roster.again[env] + p.roster.ahead[env] == 0
    if fresh and p.prescribed.progress[env] < wp.float64(1.0):
        enter(env, STARTING, p)


@wp.kernel
def _choose_ahead_kernel(p: Progress):
    """Choose the environments whose caller has said where they may be."""
    env = wp.tid()
    if p.phases.fresh[env] != 0 and p.roster.ahead[env] != 0:
        enter(env, STARTING, p)


@wp.kernel
def _ahead_kernel(
    nodes: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    places: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    p: Progress,
):
    """The way of free nodes to ``places``."""
    env, i = wp.tid()
    if p.phases.fresh[env] != 0 and p.roster.ahead[env] != 0:
        node = nodes[i]
        displacements[env, node] = places[env, node] - positions[env, node]


@wp.kernel
def _choose_flight_kernel(turns: wp.array(dtype=wp.float64), least: wp.float64, p: Progress):
    """Where frames are not in a steady motion, choose the environments in which a body flies."""
    env = wp.tid()
    if p.phases.fresh[env] != 0 and p.phases.inner[env] == 0 and turns[env] > least:
        enter(env, STARTING, p)
        p.phases.flying[env] = 1
        p.flags.any_flight[0] = 1


@wp.kernel
def _keep_free_kernel(collisions: ListRoom, p: Progress):
    """Keeps those of the chosen with nothing in the way; aims their frames at the end. Where frames
    turned out not to be steady the mask alone was cleared."""
    env = wp.tid()
    if p.phases.fresh[env] == 0:
        return
    if p.phases.inner[env] == 0:
        leave(env, p)
        return
    p.counts.starts_tried[env] += 1
    p.prescribed.goal[env] = wp.float64(1.0)
    if p.phases.flying[env] != 0:
        p.prescribed.goal[env] = p.prescribed.progress[env]
    # A straight way ahead leads through what the tool pushes aside.
    if p.clearance.limit[env] < wp.float64(1.0) and p.roster.ahead[env] == 0:
        leave(env, p)
        return
    begin_trial(env, collisions, p)


@wp.kernel
def _accept_kernel(collisions: ListRoom, p: Progress):
    """Keeps those of the chosen without an inverted element; free flight must lower the energy."""
    env = wp.tid()
    if p.phases.inner[env] == 0:
        return
    if overflows(env, collisions):
        stop(env, _CONTACT_OVERFLOW, p)
        return
    good = wp.isfinite(p.search.after[env])
    if p.phases.flying[env] != 0 and not (p.search.after[env] < p.search.before[env]):
        good = False
    if not good:
        leave(env, p)
        return
    p.counts.starts_taken[env] += 1
    p.prescribed.progress[env] = p.prescribed.trial_progress[env]
    p.search.base[env] = p.search.base_after[env]
    p.search.before[env] = p.search.after[env]


@wp.kernel
def _choose_others_kernel(p: Progress):
    """``inner`` becomes those that have not taken a start."""
    env = wp.tid()
    if p.phases.fresh[env] == 0:
        return
    if p.phases.phase[env] == STARTING:
        leave(env, p)
    else:
        enter(env, STAYING, p)


@wp.kernel
def _go_on_kernel(p: Progress):
    env = wp.tid()
    if p.phases.fresh[env] != 0:
        p.phases.flying[env] = 0
        leave(env, p)


def start_step(run: StepLaunches) -> None:
    """Pairs, collisions and frozen friction at the start of the step; then the start of the search,
    its collisions and its energy."""
    s, p, state = run.s, run.p, run.state
    x = state.positions
    zero_rows(p.phases.fresh, s.displacements)
    plans = bool(run.model.kinematic) or (s.affine is not None and s.inertia is not None)
    if plans:
        plan_start(run)
    find_pairs(run, p.phases.fresh, s.end_poses, p.clearance.margin)
    run.collide(p.phases.fresh, x)
    run.check_room(p.phases.fresh, s.collisions)
    if s.friction is not None:
        s.friction.lag(p.phases.fresh, x, s.origin)
    if not plans:
        run.energy(p.phases.fresh, x, state.poses, p.search.base, p.search.before)
        return

    def energy_before() -> None:
        run.energy(p.phases.inner, x, state.poses, p.search.base, p.search.before)

    limit_step(run, p.phases.inner, gaps_known=False)
    if s.affine is not None and s.inertia is not None:
        wp.capture_if(p.flags.any_flight, on_true=energy_before)
    run.decide(_keep_free_kernel, s.collisions.room)
    place_trial(run, run.inner)
    evaluate_trial(run, run.inner)
    sum_energies(p.phases.inner, run.energies, p.search.base_after, p.search.after)
    run.decide(_accept_kernel, s.collisions.room)
    run.commit(p.phases.inner, s.trial, s.trial_poses)
    run.decide(_choose_others_kernel)
    run.collide(p.phases.inner, x)
    run.energy(p.phases.inner, x, state.poses, p.search.base, p.search.before)
    run.decide(_go_on_kernel)


def plan_start(run: StepLaunches) -> None:
    """The way to the start, in ``displacements``; ``inner`` are those that have one."""
    s, p, state = run.s, run.p, run.state
    model, displacements = run.model, s.displacements
    run.decide(_choose_momentum_kernel)
    path = (state.poses, s.end_poses)
    if model.kinematic:
        s.frame_nodes.aim(p.phases.fresh, p.phases.inner, path, state.positions, displacements)
        keep_steady(model, p.phases.inner, s.dts, state.velocities, displacements, _LARGEST_CHANGE)
    coast(model, p.phases.inner, s.dts, state.velocities, displacements)
    if s.orders.looks_ahead:
        run.decide(_choose_ahead_kernel)
        s.frame_nodes.aim(p.phases.fresh, p.phases.inner, path, state.positions, displacements)
        ways = [model.free_nodes, state.positions, s.trial, displacements, p.struct]
        launch(_ahead_kernel, (model.env_count, model.free_count), *ways)
    if s.affine is not None and s.inertia is not None:
        copy_rows(p.phases.fresh, state.positions, s.trial)
        forces, inertial = p.balance.body_forces, s.inertia.predictions
        turn = p.clearance.flight_turn_sq
        predict_affine(model, p.phases.fresh, inertial, s.trial, turn, forces)
        run.decide(_choose_flight_kernel, turn, _SMALL_TURN_SQ)
        wp.capture_if(p.flags.any_flight, on_true=lambda: _fly(run))
    embed_vertices(model, displacements)


def _fly(run: StepLaunches) -> None:
    """The ways of the environments ``flying``, whose control nodes are in ``trial``; gels on the
    bodies come along."""
    s, p, state = run.s, run.p, run.state
    if s.joints is not None:
        s.joints.set_frames(state.poses)
        s.joints.close_predicted(p.phases.flying, s.trial)
    ride_along(run.model, p.phases.flying, state.positions, s.trial)
    subtract_rows(p.phases.flying, s.trial, state.positions, s.displacements)
