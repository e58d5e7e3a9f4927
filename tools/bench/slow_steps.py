# SPDX-License-Identifier: Apache-2.0
"""The suite ``slow_steps``: slow steps of a learning loop, taken again from where they began.

A batch waits for its slowest environment, and of a thousand steps a few dozen are slow. Steps are
recorded once, to a file; another version of the code, or other settings, starts from the same
states, so that a hundredth of the steps of two whole runs shows a difference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from taccel_lab.benchmarks.learning import Learning, LearningLoop
from taccel_lab.benchmarks.results import ResultFile, Suite, Ticker
from taccel_lab.benchmarks.scenes import SCENES, SceneOptions, build_scene
from taccel_lab.benchmarks.speed import parse_settings
from taccel_lab.errors import InputError
from taccel_lab.files.arrays import finite_numbers, read_npz
from taccel_lab.files.atomic_file import write_by
from taccel_lab.guards import require_known, require_range
from taccel_lab.solvers import SolverIPC, StepReport
from taccel_lab.state import State, initial_state

STARTS = ("positions", "velocities", "poses")
"""Arrays of the state that a step begins with."""
COLUMNS = (*STARTS, "targets", "newton", "ends")
"""Arrays of the file, a row a step; ``ends`` [m] and ``newton``: what it led to when recorded."""


@dataclass(frozen=True)
class SlowSteps(Suite):
    """Slow steps of a learning loop, taken again from where they began."""

    name: ClassVar[str] = "slow_steps"
    what: ClassVar[str] = (
        "Newton iterations of slow steps of a learning loop, and of a sample of the others, when "
        "they were recorded and taken again; how far off they ended."
    )
    shown: ClassVar[tuple[str, ...]] = (
        "steps", "recorded: mean", "again: mean", "again: p99", "halved", "failed", "moved_um_p95",
    )  # fmt: skip
    starts: Path = Path("out/benchmarks/slow_steps.npz")
    """Recorded steps: read where the file is, else written."""
    scene: str = "peg"
    """Scene, as of ``learning``."""
    envs: int = 64
    """Environments that steps are recorded of."""
    steps: int = 60
    """Steps of each of them, after one through the whole motion."""
    slow: int = 15
    """Newton iterations from which a step is slow."""
    share: float = 0.04
    """Part of the other steps that is recorded, too."""
    seed: int = 1
    """Seed of phases, targets and of that part."""
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""
    set: tuple[str, ...] = ()
    """Solver settings other than the scene's where steps are taken again."""

    def measure_rows(self, result: ResultFile) -> None:
        """Slow steps, then the others."""
        require_known("scene", self.scene, SCENES)
        require_range("--share", self.share, 0, 1)
        if min(self.envs, self.steps, self.slow) < 1:
            raise InputError("--envs, --steps and --slow must be at least 1")
        if not self.starts.exists():
            write_by(self.starts, partial(np.savez_compressed, **record(self)))
        found = read_npz(self.starts, COLUMNS)
        recorded = {name: finite_numbers(found, name, self.starts) for name in COLUMNS}
        report, ends = take_again(self, recorded)
        slow = recorded["newton"] >= self.slow
        for label, who in (("slow", slow), ("others", ~slow)):
            if who.any():
                result.measure(label, partial(figures, label, who, recorded, report, ends))


class Recorder(LearningLoop):
    """A learning loop that keeps the starts and ends of some of its steps."""

    def __init__(self, options: SlowSteps) -> None:
        bench = build_scene(options.scene, SceneOptions(options.envs, options.source, {}))
        loop = Learning(device=options.device, scene=options.scene, seed=options.seed)
        super().__init__(bench, loop)
        self._slow, self._share = options.slow, options.share
        self._choice = np.random.default_rng(options.seed)
        self.kept: dict[str, list[np.ndarray]] = {name: [] for name in COLUMNS}

    def _step(self, targets: np.ndarray, ready: np.ndarray) -> StepReport:
        before = [getattr(self.state, name).numpy().copy() for name in STARTS]
        report = super()._step(targets, ready)
        newton = report.newton_iterations
        who = (newton >= self._slow) | (self._choice.random(len(newton)) < self._share)
        who &= report.converged
        rows = [*before, targets, newton, self.state.positions.numpy()]
        for name, row in zip(COLUMNS, rows, strict=True):
            self.kept[name].append(row[who])
        return report


def record(options: SlowSteps) -> dict[str, np.ndarray]:
    """Steps of a loop, ``COLUMNS``.

    Raises:
        InputError: None of them was chosen.
    """
    loop = Recorder(options)
    loop.run(loop.phases.warm_up, Ticker(f"{options.scene}, warming up"))
    loop.kept = {name: [] for name in COLUMNS}
    loop.run(options.steps, Ticker(f"{options.scene}, recording"))
    kept = {name: np.concatenate(rows) for name, rows in loop.kept.items()}
    if not len(kept["newton"]):
        raise InputError("no step was recorded: record more --steps, or a larger --share")
    return kept


def take_again(
    options: SlowSteps, recorded: Mapping[str, np.ndarray]
) -> tuple[StepReport, np.ndarray]:
    """The recorded steps at once, an environment each: their report and ends [m].

    Raises:
        InputError: They are those of another scene.
    """
    count = len(recorded["newton"])
    chosen = SceneOptions(count, options.source, parse_settings(options.set))
    bench = build_scene(options.scene, chosen)
    solver = SolverIPC(bench.scene.finalize(options.device), bench.config)
    state: State = initial_state(solver.model, bench.targets(0))
    for name in STARTS:
        array = getattr(state, name)
        if recorded[name].shape != array.numpy().shape:
            raise InputError(
                f"{options.starts} holds {name} of shape {recorded[name].shape}; {options.scene} "
                f"({bench.source} meshes) has {array.numpy().shape}: record its own steps"
            )
        array.assign(recorded[name])
    report = solver.step(state, recorded["targets"])
    return report, state.positions.numpy()


def figures(
    label: str,
    who: np.ndarray,
    recorded: Mapping[str, np.ndarray],
    report: StepReport,
    ends: np.ndarray,
) -> dict[str, Any]:
    """A row, of the steps of ``who``."""
    moved = 1e6 * np.linalg.norm(ends - recorded["ends"], axis=2).max(axis=1)
    return {
        "group": label,
        "steps": int(who.sum()),
        "recorded": spread_of(recorded["newton"][who]),
        "again": spread_of(report.newton_iterations[who]),
        "friction_lags_mean": float(report.friction_lags[who].mean()),
        "halved": int((report.substeps > 1)[who].sum()),
        "failed": int((~report.converged)[who].sum()),
        "moved_um_p95": float(np.percentile(moved[who], 95)),
    }


def spread_of(newton: np.ndarray) -> dict[str, float]:
    """Newton iterations of steps: mean, percentiles, most."""
    p90, p99 = np.percentile(newton, [90, 99])
    return {"mean": float(newton.mean()), "p90": p90, "p99": p99, "most": float(newton.max())}
