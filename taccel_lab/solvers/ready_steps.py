# SPDX-License-Identifier: Apache-2.0
"""Steps in which nobody waits: each environment begins its next one when its last one is over.

A batch that steps together takes as long as its slowest environment, and in a learning loop some
environment is always at a first contact: of 1,024 pegs the mean takes 5 Newton iterations and the
slowest 40. Here a call does a few rounds of whatever step each environment is in.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_range
from taccel_lab.model.env_rows import checked_mask, device_mask
from taccel_lab.solvers.config import Control
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.step_report import EnvStatus, StepReport
from taccel_lab.state import State
from taccel_lab.typed import typed


@typed
class ReadySteps:
    """Steps a solver's environments each at its own pace.

    What is underway must not be touched; ``drop`` and ``SolverIPC.reset`` give it up.
    """

    def __init__(self, solver: SolverIPC, state: State, iterations: int = 4) -> None:
        """``iterations``: rounds a call, at most: each a Newton iteration, or one more trial of a
        line search."""
        require_range("iterations", iterations, 1, math.inf)
        self.solver, self.state, self.iterations = solver, state, iterations

    @property
    def underway(self) -> np.ndarray:
        """Environments whose step is not over, bool, [env_count]."""
        with self.solver.at_work():
            return self.solver.progress.underway

    def step_ready(
        self, control: Control | Any = None, who: np.ndarray | None = None
    ) -> StepReport:
        """Begin a step in the environments of ``who`` and go on in those underway.

        ``control``: targets and loads of the steps that begin, as of ``SolverIPC.step``; read for
        ``who`` alone, so that each environment's step may have its own length. ``who``: bool,
        [env_count]; all that are not underway when None.

        In the report, RUNNING are those whose step is underway, and SKIPPED those that take none.
        All others are ready for their next step, and their forces are those of this report until
        then. One that failed is where its step began; it is not tried in halves here, but
        ``SolverIPC.step`` will when nothing is underway. In the state each environment is where its
        last step ended, until its next one has. A call that is interrupted gives up all steps.
        """
        started = time.perf_counter()
        solver, state, progress = self.solver, self.state, self.solver.progress
        with solver.at_work(state):
            count = solver.model.env_count
            who = ~progress.underway if who is None else checked_mask(who, count).copy()
            if (who & progress.underway).any():
                env = int(np.flatnonzero(who & progress.underway)[0])
                raise InputError(f"environment {env} has not finished its last step yet")
            dt = solver.take(control, state, who)
            solver.begin(state)
            solver.set_dt(dt, who if progress.underway.any() else None)
            solver.follow_parameters()
            solver.search_overlaps(state)
            solver.orders.tell("again", solver.nobody)
            solver.orders.look(None)
            solver.limit_rounds(self.iterations)
            report = solver.attempt_once(who | progress.again, who, solver.everyone)
            progress.underway |= who
            status = np.where(progress.underway, report.status, int(EnvStatus.SKIPPED))
            progress.again[:] = solver.prepare_again(status)
            running = int(EnvStatus.RUNNING)
            status[progress.again] = running
            ended = progress.underway & (status != running)
            report = solver.find_blocked(state, replace(report, status=status), ended)
            progress.underway &= report.status == running
            solver.end(state)
        return replace(
            report,
            substeps=report.converged.astype(np.int64),
            seconds=time.perf_counter() - started,
        )

    def drop(self, who: np.ndarray) -> None:
        """Give up the steps of the environments of ``who`` (bool, [env_count]) that are underway:
        they are where these began."""
        with self.solver.at_work(self.state):
            progress = self.solver.progress
            who = progress.underway & checked_mask(who, len(progress.underway))
            progress.drop(who, device_mask(who, len(who), self.solver.model.device))
