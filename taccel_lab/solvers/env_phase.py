# SPDX-License-Identifier: Apache-2.0
"""Where each environment stands in a step: one phase each, and how it changes."""

from __future__ import annotations

from enum import IntEnum

import warp as wp

from taccel_lab.solvers.env_progress import Counts, Flags, Phases, Rules
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
    """Its line search goes on."""
    CLOSING = 5
    """Newton has converged, its joints may be open."""
    FREEZING = 6
    """Its friction is frozen anew."""
    RETREATING = 7
    """It takes back a part of its step, or all."""


STEPPING = wp.constant(int(EnvPhase.STEPPING))
STARTING = wp.constant(int(EnvPhase.STARTING))
STAYING = wp.constant(int(EnvPhase.STAYING))
SEARCHING = wp.constant(int(EnvPhase.SEARCHING))
CLOSING = wp.constant(int(EnvPhase.CLOSING))
FREEZING = wp.constant(int(EnvPhase.FREEZING))
RETREATING = wp.constant(int(EnvPhase.RETREATING))
_RESTING = wp.constant(int(EnvPhase.RESTING))
_NO_CONVERGENCE = wp.constant(int(EnvStatus.NO_CONVERGENCE))


@wp.func
def enter(
    env: int,
    phase: int,
    phases: Phases,  # out
):
    """Take part in what only some environments do."""
    phases.phase[env] = phase
    phases.inner[env] = 1


@wp.func
def leave(
    env: int,
    phases: Phases,  # out
):
    """Go on like all others."""
    phases.phase[env] = STEPPING
    phases.inner[env] = 0


@wp.func
def stop(
    env: int,
    status: int,
    phases: Phases,  # out
):
    """End the step of an environment."""
    phases.status[env] = status
    phases.phase[env] = _RESTING
    phases.active[env] = 0
    phases.inner[env] = 0
    phases.fresh[env] = 0


@wp.func
def go_on(
    env: int,
    phases: Phases,  # out
    counts: Counts,
    flags: Flags,  # out
    r: Rules,
):
    """Stop where the iterations are used up; ``running`` says whether anything goes on. Not where
    friction is frozen anew first, or a step taken back."""
    if phases.active[env] != 0 and phases.phase[env] < FREEZING:
        if counts.newton[env] >= r.max_newton:
            stop(env, _NO_CONVERGENCE, phases)
        elif flags.rounds[0] < flags.most_rounds[0]:
            flags.running[0] = 1
