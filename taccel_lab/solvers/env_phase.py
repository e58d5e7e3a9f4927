# SPDX-License-Identifier: Apache-2.0
"""Where each environment stands in a step: one phase each, and how it changes."""

from __future__ import annotations

from enum import IntEnum

import warp as wp

from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})


class EnvPhase(IntEnum):
    """What a step does with an environment at the moment."""

    RESTING = 0
    """Nothing: it takes no step, or its step is over."""
    STEPPING = 1
    """It takes part in the stage at hand like all others."""
    STARTING = 2
    """A start of its step away from where it is, is being tried."""
    STAYING = 3
    """Its step starts from where it is."""
    SEARCHING = 4
    """Its line search goes on, a trial a round."""
    CLOSING = 5
    """Newton has converged, its joints may be open."""
    FREEZING = 6
    """Its friction is frozen anew."""


STEPPING = wp.constant(int(EnvPhase.STEPPING))
STARTING = wp.constant(int(EnvPhase.STARTING))
STAYING = wp.constant(int(EnvPhase.STAYING))
SEARCHING = wp.constant(int(EnvPhase.SEARCHING))
CLOSING = wp.constant(int(EnvPhase.CLOSING))
FREEZING = wp.constant(int(EnvPhase.FREEZING))
_RESTING = wp.constant(int(EnvPhase.RESTING))
_NO_CONVERGENCE = wp.constant(int(EnvStatus.NO_CONVERGENCE))
_STALLED = wp.constant(int(EnvStatus.STALLED))
STALL_AFTER = wp.constant(100)
"""Iterations without a gain that end a step. Steps that converge had at most 15, pins and edges on
plateaus of up to 168 iterations and under friction of 1; those that do not had up to 179 of 200."""
_LESS_EXCESS = 0.99
"""Part of the least residual so far that counts as less."""
_LESS_ENERGY = 1e-4
"""Fall of the energy that counts, as a part of it: on a plateau it falls by 1e-3 an iteration."""
_MORE_PROGRESS = 1e-3
"""Part of the prescribed motion that counts."""


@wp.func
def enter(env: int, phase: int, p: Progress):
    """Take part in what only some environments do."""
    p.phases.phase[env] = phase
    p.phases.stepping[env] = 0
    if phase == SEARCHING:
        p.phases.searching[env] = 1
    else:
        p.phases.inner[env] = 1


@wp.func
def leave(env: int, p: Progress):
    """Go on like all others."""
    p.phases.phase[env] = STEPPING
    p.phases.stepping[env] = 1
    p.phases.searching[env] = 0
    p.phases.inner[env] = 0


@wp.func
def stop(env: int, status: int, p: Progress):
    """End the step of an environment."""
    p.phases.status[env] = status
    p.phases.phase[env] = _RESTING
    p.phases.active[env] = 0
    p.phases.stepping[env] = 0
    p.phases.searching[env] = 0
    p.phases.inner[env] = 0
    p.phases.fresh[env] = 0


@wp.func
def forget_gain(env: int, p: Progress):
    """What was reached before says nothing of what follows."""
    p.gain.least_excess[env] = wp.float64(wp.inf)
    p.gain.least_energy[env] = wp.float64(wp.inf)
    p.gain.idle[env] = 0


@wp.func
def gains(env: int, p: Progress) -> bool:
    """Whether the last iteration has brought the step on: the frames, or the residual, or, as on
    the plateau around a saddle where the residual rises and falls, the energy."""
    progress = p.prescribed.progress[env]
    if progress < wp.float64(1.0):
        on = progress > p.gain.counted[env] + wp.float64(_MORE_PROGRESS)
        if on:
            p.gain.counted[env] = progress
        return on
    on = bool(False)
    excess = p.balance.excess[env]
    if excess < wp.float64(_LESS_EXCESS) * p.gain.least_excess[env]:
        p.gain.least_excess[env] = excess
        on = True
    energy = p.search.after[env]
    least = p.gain.least_energy[env]
    if wp.isfinite(energy) and (
        not wp.isfinite(least) or energy < least - wp.float64(_LESS_ENERGY) * wp.abs(least)
    ):
        p.gain.least_energy[env] = energy
        on = True
    return on


@wp.func
def count_on(env: int, p: Progress):
    """Go on in the next round, if there is one; ``running`` says whether any environment does."""
    if p.flags.rounds[0] < p.flags.most_rounds[0]:
        before = wp.atomic_add(p.flags.going, 0, 1)
        p.flags.running[0] = 1
        if before >= p.rules.few:
            p.flags.some_running[0] = 1
        if before >= p.rules.some:
            p.flags.many_running[0] = 1


@wp.func
def go_on(env: int, p: Progress):
    """Stop where the iterations are used up, or lead nowhere. Not where friction is frozen anew
    first, or a line search goes on: a trial counts that."""
    if p.phases.phase[env] == SEARCHING:
        # Since the last call, whose trial counted for that one.
        if p.flags.rounds[0] == 0:
            count_on(env, p)
    elif p.phases.active[env] != 0 and p.phases.phase[env] < FREEZING:
        if gains(env, p):
            p.gain.idle[env] = 0
        else:
            p.gain.idle[env] += 1
        if p.counts.newton[env] >= p.rules.max_newton:
            stop(env, _NO_CONVERGENCE, p)
        elif p.gain.idle[env] > STALL_AFTER:
            stop(env, _STALLED, p)
        else:
            count_on(env, p)
