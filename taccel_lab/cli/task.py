# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab task list``, ``run`` and ``record``: tasks with criterion, seeds and a baseline."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.tasks.catalogue import Task
    from taccel_lab.tasks.result import TaskResult

MOST_SEEDS = 100_000


@dataclass(frozen=True)
class TaskList:
    """List the tasks."""

    json: bool = False
    """Print JSON instead of a table, with the figures of others."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json, print_table
        from taccel_lab.tasks.catalogue import named, names

        tasks = {name: named(name).parameters for name in names()}
        if self.json:
            print_json({name: task.model_dump(mode="json") for name, task in tasks.items()})
            return
        rows = [(name, t.summary, t.criterion, str(t.seeds)) for name, t in tasks.items()]
        print_table(("task", "what", "criterion", "seeds"), rows)


@dataclass(frozen=True)
class TaskRun:
    """Run the baseline policy of a task on its seeds: success rate with its 95 % interval.

    Writes result.json (settings, machine, a row a seed). A seed whose simulation fails counts as a
    failure, with its cause. Ctrl-C ends the run and keeps what is done.
    """

    task: Positional[str]
    """A task of ``task list``, or a file like those of the package."""
    out: Path
    """Folder to write; an earlier one is replaced when everything is done."""
    seeds: int | None = None
    """Run seeds 0 to N - 1. Default: the task's number."""
    environments: int | None = None
    """Seeds that one solver steps together. Default: the task's number. A GPU is quicker with
    hundreds."""
    device: str = "cpu"
    """Device of the solver: cpu, cuda:0 or auto."""
    json: bool = False
    """Print rate, interval and figures as JSON instead of lines."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, print_json
        from taccel_lab.files.output_folder import atomic_directory
        from taccel_lab.progress import stage_progress
        from taccel_lab.tasks.catalogue import run_task

        if self.seeds is not None and not 1 <= self.seeds <= MOST_SEEDS:
            raise InputError(f"seeds must lie in 1..{MOST_SEEDS}, got {self.seeds}")
        if self.environments is not None and not 1 <= self.environments <= MOST_SEEDS:
            raise InputError(f"environments must lie in 1..{MOST_SEEDS}, got {self.environments}")
        task = _begin(self.task, self.device, self.out)
        if self.environments is not None:
            parameters = task.parameters.replace(environments=self.environments)
            task = replace(task, parameters=parameters)
        console = notes()
        with atomic_directory(self.out) as folder:
            with stage_progress(console) as progress:
                seeds = range(self.seeds or task.parameters.seeds)
                result = run_task(task, seeds, self.device, progress=progress)
            _write(task, result, self.device, folder)
        if self.json:
            print_json(result.table())
        else:
            _print(console, result, self.out)
        if len(result.trials) < result.asked:
            console.print(
                f"interrupted; {len(result.trials)} of {result.asked} seeds are kept",
            )
            raise SystemExit(130)


@dataclass(frozen=True)
class TaskRecord:
    """Record one seed of a task: bodies, forces and the gel's tactile image, depth, pressure and
    markers of every frame, for taccel-lab view.

    Writes replay.json, replay.npz, and trial.json.
    """

    task: Positional[str]
    """A task of ``task list``, or a file like those of the package."""
    out: Path
    """Folder to write; an earlier one is replaced when everything is done."""
    seed: int = 0
    """Which start."""
    device: str = "cpu"
    """Device of the solver: cpu, cuda:0 or auto."""
    json: bool = False
    """Print the outcome of the seed as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, print_json, working
        from taccel_lab.files.atomic_file import write_json
        from taccel_lab.files.output_folder import atomic_directory
        from taccel_lab.learning.gel_colors import default_colors
        from taccel_lab.progress import stage_progress
        from taccel_lab.tasks.replay import record_seed, write_replay

        if not 0 <= self.seed < MOST_SEEDS:
            raise InputError(f"seed must lie in 0..{MOST_SEEDS - 1}, got {self.seed}")
        task = _begin(self.task, self.device, self.out)
        console = notes()
        with atomic_directory(self.out) as folder:
            with stage_progress(console) as progress:
                replay, trial = record_seed(
                    task, self.seed, self.device, progress, colors=default_colors(None)
                )
            with working(console, "writing the replay"):
                write_replay(replay, folder)
            values = {name: value for name, value in vars(trial).items() if name != "felt"}
            values = {"task": task.name, **values}
            write_json(folder / "trial.json", values)
        if self.json:
            print_json(values)
        done = "success" if trial.success else trial.cause
        console.print(f"seed {trial.seed}: {done}")
        console.print(f"wrote {self.out}; look at it: taccel-lab view {self.out}", soft_wrap=True)


def _begin(name: str, device: str, output: Path) -> Task:
    """A task of the package, or of a file; refused with device and output folder before work."""
    from taccel_lab.files.output_folder import require_replaceable
    from taccel_lab.model.launches import require_device
    from taccel_lab.processes.start_warp import start_warp
    from taccel_lab.tasks.catalogue import named, read_task

    start_warp()
    task = read_task(Path(name)) if name.endswith(".toml") else named(name)
    require_device(device)
    require_replaceable(output)
    return task


def _write(task: Task, result: TaskResult, device: str, folder: Path) -> None:
    from taccel_lab.files.atomic_file import write_json
    from taccel_lab.report.machine import describe_run

    table = result.table()
    rows = table.pop("per_seed")
    settings = task.parameters.model_dump(mode="json")
    run = describe_run(device)
    write_json(
        folder / "result.json", {**table, "settings": settings, "run": run, "per_seed": rows}
    )


def _print(console: Console, result: TaskResult, output: Path) -> None:
    table = result.table()
    low, high = table["interval_95"]
    lines = [
        f"{table['task']}: {table['successes']} of {table['trials']} seeds, "
        f"{table['success_rate']:.1%} (95 %: {low:.1%} to {high:.1%}, Wilson)"
    ]
    for name, spread in table["figures"].items():
        if spread:
            lines.append(
                f"  {name}: median {spread['median']:.4g}, 5 % {spread['p05']:.4g}, "
                f"95 % {spread['p95']:.4g}"
            )
    causes = [(trial.seed, trial.cause) for trial in result.trials if trial.cause]
    lines += [f"  seed {seed}: {cause}" for seed, cause in causes[:10]]
    if causes[10:]:
        lines.append(f"  and {len(causes) - 10} more failures")
    lines.append(f"wrote {output / 'result.json'}")
    for line in lines:
        console.print(line, soft_wrap=True)
