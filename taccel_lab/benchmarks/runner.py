# SPDX-License-Identifier: Apache-2.0
"""Step a scene through its motion as a user would: set targets, step, read forces.

The end-to-end time of a step is that of all three, until the forces on each gel are on the host;
``taccel_lab.benchmarks.measure`` says which clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.benchmarks.measure import clock_of
from taccel_lab.benchmarks.results import spread
from taccel_lab.benchmarks.scenes.base import RESIDUAL_N, RESIDUAL_RATIO, BenchScene
from taccel_lab.ipc.contact.overlap_search import require_separated
from taccel_lab.model import Model
from taccel_lab.outputs.soft_wrenches import SoftWrenchReader
from taccel_lab.progress import Progress, silent
from taccel_lab.solvers import EnvStatus, SolverIPC, StepReport
from taccel_lab.state import State, initial_state

SHOWN = (
    "fps: median", "fps: min", "fps: max", "ms_per_step: median", "newton_mean",
    "residual: worst_over_contact_force", "residual: unconverged", "memory_mib_per_env",
)  # fmt: skip
"""Figures of a row of steps that are shown while it runs."""


class ForceProbe:
    """Contact and friction force on each soft body [N], [env, soft body, 3], on the host."""

    def __init__(self, solver: SolverIPC) -> None:
        self._wrenches = SoftWrenchReader(solver, in_mounts=False)

    def read(self, state: State) -> np.ndarray:
        """Forces of the last step, which led to ``state``; in world axes."""
        return self._wrenches.read(state).numpy()[..., :3]


KEPT = (
    "status", "substeps", "newton_iterations", "cg_iterations", "friction_lags", "searches",
    "ccd_passes", "starts_taken", "residual_n", "contact_force_n", "min_distance_m",
)  # fmt: skip
"""Arrays of a report that figures are made of."""


@dataclass
class BenchmarkMotion:
    """Figures of a run, a list over its calls unless said otherwise."""

    env_steps: int = 0
    """Steps of environments, of the whole run."""
    seconds: list[float] = field(default_factory=list)
    """End to end: targets set, stepped, forces read."""
    solver_seconds: list[float] = field(default_factory=list)
    finished: list[dict[str, np.ndarray]] = field(default_factory=list)
    """What reports say of environments that finished, ``KEPT``."""
    forces_n: list[np.ndarray] = field(default_factory=list)
    """Force on each soft body, [env, body, 3]."""

    @property
    def fps(self) -> float:
        """Environments x steps / seconds, end to end."""
        return self.env_steps / sum(self.seconds)

    @property
    def solver_fps(self) -> float:
        """The same without setting targets and reading forces."""
        return self.env_steps / sum(self.solver_seconds)

    def add(self, report: StepReport, seconds: float, solver_seconds: float) -> None:
        """One step, or what a call finished of several."""
        self.seconds.append(seconds)
        self.solver_seconds.append(solver_seconds)
        self.env_steps += len(report.status)
        self.finished.append({name: getattr(report, name) for name in KEPT})

    def of(self, name: str) -> np.ndarray:
        """One of ``KEPT`` over all steps of environments."""
        return np.concatenate([figures[name] for figures in self.finished])

    def largest_newton_mean(self) -> float:
        """Most Newton iterations of a call, in the mean over the steps that it finished."""
        calls = [figures["newton_iterations"] for figures in self.finished]
        most = [call.max(initial=0) for call in calls]
        return float(np.average(most, weights=[len(call) for call in calls]))

    def residual(self) -> dict[str, Any]:
        """What the speed was reached at."""
        status, contact = self.of("status"), self.of("contact_force_n")
        good = status == EnvStatus.CONVERGED
        residual = np.where(good, self.of("residual_n"), 0.0)
        touching = contact > RESIDUAL_N / RESIDUAL_RATIO
        allowed = np.maximum(RESIDUAL_RATIO * contact, RESIDUAL_N)
        return {
            "worst_n": float(residual.max()),
            "worst_over_contact_force": float(
                (residual / np.where(touching, contact, np.inf)).max()
            ),
            "worst_over_allowed": float((residual / allowed).max()),
            "allowed": f"max({RESIDUAL_RATIO:g} of the contact force, {RESIDUAL_N:g} N)",
            "env_steps": self.env_steps,
            "unconverged": int((~good).sum()),
            "taken_in_parts": int((good & (self.of("substeps") > 1)).sum()),
            "causes": dict(Counter(EnvStatus(one).name for one in status[~good])),
        }

    def work(self) -> dict[str, Any]:
        """Iterations a step."""
        newton = self.of("newton_iterations")
        median, p90, p99, p999 = np.percentile(newton, [50, 90, 99, 99.9])
        return {
            "newton_mean": float(newton.mean()),
            "newton_median": float(median),
            "newton_p90": float(p90),
            "newton_p99": float(p99),
            "newton_p999": float(p999),
            "newton_worst": int(newton.max()),
            "cg_mean": float(self.of("cg_iterations").mean()),
            "friction_lags_mean": float(self.of("friction_lags").mean()),
            "contact_force_mean_n": float(self.of("contact_force_n").mean()),
            "min_distance_um": 1e6 * float(self.of("min_distance_m").min()),
        }


def middle_of(runs: Sequence[BenchmarkMotion]) -> int:
    """Which of repeated runs has the median speed."""
    return int(np.argsort([run.fps for run in runs])[len(runs) // 2])


def figures_of(runs: Sequence[BenchmarkMotion], bench: BenchScene, model: Model) -> dict[str, Any]:
    """What rows of repeated runs have in common: the scene, speeds, the worst residual, the work of
    the median run."""
    residuals = [run.residual() for run in runs]
    worst = max(residuals, key=lambda r: (r["unconverged"], r["worst_over_allowed"]))
    return {
        "scene": bench.name,
        "what": bench.what,
        "source": bench.source,
        "envs": model.env_count,
        "soft_nodes": model.soft_count,
        "unknowns": 3 * model.free_count,
        "fps": spread([run.fps for run in runs]),
        "solver_fps": spread([run.solver_fps for run in runs]),
        "residual": {**worst, "repeats": len(runs)},
        **runs[middle_of(runs)].work(),
    }


class Runner:
    """Model, solver and state of a scene on a device, built once and run as often as wanted.

    The start is searched for overlaps once, here, and not again at the first step of every run.
    """

    def __init__(self, bench: BenchScene, device: str = "cpu") -> None:
        self.bench = bench
        self.model: Model = bench.scene.finalize(device)
        self.solver = SolverIPC(self.model, replace(bench.config, check_start=False))
        self.state = initial_state(self.model, bench.targets(0))
        require_separated(self.model, self.state)
        self.forces = ForceProbe(self.solver)
        self.clock = clock_of(self.model.device)

    def reset(self) -> None:
        """All environments back to the start of the motion."""
        everyone = np.ones(self.model.env_count, dtype=bool)
        self.solver.reset(self.state, everyone, self.bench.targets(0))

    def run(
        self, steps: int | None = None, *, keep_forces: bool = False, progress: Progress = silent
    ) -> BenchmarkMotion:
        """The first ``steps`` of the motion, all of it when None, from the start."""
        count = self.bench.steps if steps is None else min(steps, self.bench.steps)
        motion = BenchmarkMotion()
        wp.synchronize_device(self.model.device)
        for step in range(1, count + 1):
            started = self.clock()
            targets = self.bench.targets(step)
            before = self.clock()
            report = self.solver.step(self.state, targets)
            after = self.clock()
            forces = self.forces.read(self.state)
            motion.add(report, self.clock() - started, after - before)
            if keep_forces:
                motion.forces_n.append(forces.copy())
            progress("steps", step, count)
        return motion
