# SPDX-License-Identifier: Apache-2.0
"""Cases from family and seed to their results, within a budget of time, each in a process that may
hang or die and takes nothing along."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import Any

import numpy as np

from taccel_lab.benchmarks.stress.case import StressCase
from taccel_lab.benchmarks.stress.families import make_case
from taccel_lab.benchmarks.stress.referees import Referees, StressFinding, Taken, take
from taccel_lab.outputs import Outputs
from taccel_lab.processes.process_pool import Died, Finished, ProcessPool
from taccel_lab.progress import Progress
from taccel_lab.solvers import SolverIPC
from taccel_lab.solvers.step_report import EnvStatus
from taccel_lab.state import State, initial_state

SECONDS = 20.0
"""Budget of a case in processor time: most take a hundredth of it."""
Watch = Callable[[int, Any, list[StressFinding]], None]
"""Called after each step with its number, report and findings."""


class BudgetOverrun(BaseException):
    """The time of a case is used up.

    No ``Exception``: it comes at any moment, and a library that catches those around its own work
    would turn it into another error.
    """


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise BudgetOverrun in here after that processor time; in the main thread only.

    Processor time, so that neighbours on the machine do not change the outcome. Time is not counted
    while a kernel is compiled, and the time starts anew: interrupted, it would never be done.
    """
    if threading.current_thread() is not threading.main_thread():
        raise RuntimeError("a case needs the main thread: its budget is kept by a signal")

    over = False
    said = f"{seconds:g} s of processor time are used up"

    def overrun(number: int, frame: FrameType | None) -> None:
        nonlocal over
        if _is_compiling(frame):
            signal.setitimer(signal.ITIMER_PROF, seconds, 0.5)
            return
        over = True
        raise BudgetOverrun(said)

    earlier = signal.signal(signal.SIGPROF, overrun)
    # Again and again: an exception raised while Python tidies up an object is lost.
    signal.setitimer(signal.ITIMER_PROF, seconds, 0.5)
    try:
        yield
    except Exception as error:
        if over:  # What is interrupted may say so in its own words, as comparisons of numpy do.
            raise BudgetOverrun(said) from error
        raise
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, earlier)


def _is_compiling(frame: FrameType | None) -> bool:
    """Whether Warp is about to load a module somewhere up the stack."""
    while frame is not None:
        code = frame.f_code
        if code.co_name == "load" and "warp" in code.co_filename:
            return True
        frame = frame.f_back
    return False


def run_case(
    family: str,
    seed: int,
    device: str = "cpu",
    seconds: float = SECONDS,
    watch: Watch | None = None,
) -> dict[str, Any]:
    """Run a case; its result is plain data.

    ``outcome`` is one of

    - ``converged``: every step of every environment did, and no referee objects;
    - ``refused``: a step that has no answer failed with a cause and was rolled back;
    - a cause of ``EnvStatus``: a step failed that has an answer;
    - ``budget``: the time was used up before;
    - ``silent``: a referee objects to a step that converged, or to a rollback;
    - ``error``: an exception, which no scene here may cause.
    """
    result: dict[str, Any] = {"family": family, "seed": seed, "outcome": "error", "says": ""}
    run = _Run(device, watch)
    started, busy = time.perf_counter(), time.process_time()
    try:
        with time_limit(seconds):
            case, result["parameters"] = make_case(family, seed)
            run.take_all(case)
        result["outcome"] = run.outcome(case)
    except BudgetOverrun as overrun:
        result["outcome"], result["says"] = "budget", str(overrun)
        if run.findings:
            result["outcome"] = "silent"
    except Exception as error:  # whatever it is, it is the result of this case
        result["says"] = f"{type(error).__name__}: {error}"
    result["seconds"] = round(time.perf_counter() - started, 3)
    result["processor_seconds"] = round(time.process_time() - busy, 3)
    return result | run.figures()


class _Run:
    """What is gathered while a case runs."""

    def __init__(self, device: str, watch: Watch | None) -> None:
        self.device, self.watch = device, watch
        self.findings: list[StressFinding] = []
        self.causes: list[str] = []
        self.newton: list[int] = []
        self.cg: list[int] = []
        self.substeps: list[int] = []
        self.step_seconds: list[float] = []
        self.asked_steps = 0
        self.referees: Referees | None = None
        self.last: Taken | None = None

    def take_all(self, case: StressCase) -> None:
        self.asked_steps = case.steps
        model = case.scene.finalize(self.device)
        solver, state = SolverIPC(model, case.config), initial_state(model, case.start)
        outputs, self.referees = Outputs(solver), Referees(case, model, case.config)
        for step in range(case.steps):
            if not self._take(case, solver, outputs, state, step):
                return

    def _take(
        self, case: StressCase, solver: SolverIPC, outputs: Outputs, state: State, step: int
    ) -> bool:
        """One step; whether there is a reason to go on."""
        assert self.referees is not None
        if case.prepare is not None:
            case.prepare(solver, state, step)
        here = state.poses.numpy().reshape(solver.model.env_count, -1, 7)
        target = here.copy() if case.targets is None else np.asarray(case.targets(step))
        taken = take(solver, outputs, state, target, case.watches_energy, self.last)
        self.last = taken
        report = taken.report
        found = self.referees.findings(taken, state, step)
        self.findings += found
        self.newton += report.newton_iterations.tolist()
        self.cg += report.cg_iterations.tolist()
        self.substeps += report.substeps.tolist()
        self.step_seconds.append(report.seconds)
        failed = ~report.converged
        self.causes += [EnvStatus(status).name for status in report.status[failed]]
        if self.watch is not None:
            self.watch(step, report, found)
        # An environment that failed would fail again from the same start.
        return not failed.all() and not found

    def outcome(self, case: StressCase) -> str:
        """See ``run_case``."""
        if self.findings:
            return "silent"
        if self.causes:
            return self.causes[0] if case.possible else "refused"
        return "converged"

    def figures(self) -> dict[str, Any]:
        """Counts and times, for the result."""
        referees = self.referees
        return {
            "causes": sorted(set(self.causes)),
            "findings": [str(finding) for finding in self.findings],
            "referees": sorted({finding.referee for finding in self.findings}),
            "steps": len(self.step_seconds),
            "asked_steps": self.asked_steps,
            "newton_iterations": self.newton,
            "cg_iterations": sum(self.cg),
            "substeps": self.substeps,
            "slowest_step_s": round(max(self.step_seconds, default=0.0), 3),
            "smallest_gap_m": float(referees.smallest_gap) if referees else np.inf,
            "residual_ratio": referees.residual_ratio if referees else 0.0,
            "balanced_steps": referees.balanced_steps if referees else 0,
            "inverted_legally": bool(referees and referees.inverted_legally),
        }


CaseId = tuple[str, int]
"""Family and seed."""
RunCase = Callable[[str, int, str, float], dict[str, Any]]
"""``(family, seed, device, seconds)``."""
PATIENCE_S = 900.0
"""Time beyond the budget after which a process is ended: kernels may have to be compiled, during
which no signal is heard."""


def run_all(
    cases: Sequence[CaseId], device: str, jobs: int, seconds: float, run: RunCase = run_case
) -> Generator[dict[str, Any], None, None]:
    """Results of the cases as they come, from ``jobs`` processes. Closing this ends them."""
    work = partial(_run, run, device, seconds)
    with ProcessPool(work, jobs, limit_s=2 * seconds + PATIENCE_S) as pool:
        for event in pool.run(cases):
            if isinstance(event, Finished):
                yield event.result
            elif isinstance(event, Died):
                family, seed = event.item
                lost = {"outcome": "died", "says": event.cause, "parameters": {}}
                yield {"family": family, "seed": seed, **lost}


def _run(
    run: RunCase, device: str, seconds: float, case: CaseId, progress: Progress
) -> dict[str, Any]:
    """A case; again when its budget went into compiling kernels, which the cache has now."""
    before = _compiled()
    result = run(*case, device, seconds)
    if result["outcome"] == "budget" and _compiled() != before:
        result = run(*case, device, seconds)
    return result


def _compiled() -> int:
    """Modules in the kernel cache."""
    import warp as wp

    folder = wp.config.kernel_cache_dir
    return len(os.listdir(folder)) if folder and os.path.isdir(folder) else 0
