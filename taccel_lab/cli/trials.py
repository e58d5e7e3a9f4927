# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab trials``: evidence from a real robot, planned, recorded and summed up."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from taccel_lab.errors import InputError
from taccel_lab.tasks.trial_outcome import Outcome


@dataclass(frozen=True)
class TrialsPlan:
    """Plan trials on a real robot: each policy from each start of a task, in a drawn order.

    Writes plan.json (number and start of each trial, for whoever lays out the object), key.json
    (its policy, for the robot's program alone) and an empty trials.jsonl.
    """

    task: Positional[str]
    """A task of ``task list`` with a start in x, y and yaw, or a changed copy of its file."""
    out: Path
    """New folder."""
    policies: tuple[str, ...]
    """Names of the policies; one of them should be a baseline."""
    starts: int = 60
    """Starts, each of which every policy gets."""
    seed: int | None = None
    """Seed of the order. Default: a secret one, kept in key.json."""
    json: bool = False
    """Print the number of trials and the folder as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, print_json
        from taccel_lab.guards import require_seed
        from taccel_lab.tasks.catalogue import named, read_task
        from taccel_lab.tasks.robot_trials import plan_trials

        if self.seed is not None:
            require_seed(self.seed)
        task = read_task(Path(self.task)) if self.task.endswith(".toml") else named(self.task)
        plan_trials(task, self.policies, self.starts, self.out, self.seed)
        count = self.starts * len(self.policies)
        if self.json:
            print_json({"trials": count, "folder": str(self.out)})
        notes().print(
            f"{count} trials in {self.out}; the first: taccel-lab trials next {self.out}",
            soft_wrap=True,
        )


@dataclass(frozen=True)
class TrialsNext:
    """Say which trial is next: its number and start, or its policy for the robot's program."""

    folder: Positional[Path]
    """Folder of ``trials plan``."""
    policy: bool = False
    """Print the policy alone. Whoever lays out the object and judges must not see it."""
    json: bool = False
    """Print number, seed and start as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json
        from taccel_lab.tasks.robot_trials import read_trials

        found = read_trials(self.folder)
        planned = found.next()
        if planned is None:
            raise InputError(f"all {len(found.plan.trials)} trials of {self.folder} are recorded")
        if self.policy:
            _tell(found.policy(planned.number))
        elif self.json:
            print_json(planned.model_dump(mode="json"))
        else:
            start = ", ".join(f"{name} {value:+.2f}" for name, value in planned.start.items())
            _tell(f"trial {planned.number} of {len(found.plan.trials)}: {start}")
            _tell(f"success: {found.plan.criterion}")


@dataclass(frozen=True)
class TrialsRecord:
    """Record what came of the next trial, as one line of trials.jsonl."""

    folder: Positional[Path]
    """Folder of ``trials plan``."""
    outcome: Positional[Outcome]
    """void: the trial was broken by something else than the policy, and is repeated."""
    number: int | None = None
    """Number of the trial, to be sure that it is the next one."""
    note: str = ""
    """What happened; void and --correct need it."""
    image: Path | None = None
    """Picture to keep in the folder."""
    correct: bool = False
    """Replace what was recorded for --number; the earlier line stays in the file."""
    json: bool = False
    """Print the line as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json, say
        from taccel_lab.tasks.robot_trials import read_trials, record_trial

        done = record_trial(
            self.folder,
            self.outcome,
            number=self.number,
            note=self.note,
            image=self.image,
            correct=self.correct,
        )
        if self.json:
            print_json(done.model_dump(mode="json"))
        found = read_trials(self.folder)
        recorded = sum(one.outcome != "void" for one in found.standing().values())
        say(f"trial {done.number}: {done.outcome}; {recorded} of {len(found.plan.trials)} recorded")


@dataclass(frozen=True)
class TrialsSummary:
    """Sum up recorded trials: a rate with its 95 % interval a policy, and policies compared by
    start. Exit code 2 until all are recorded, unless --interim is given."""

    folder: Positional[Path]
    """Folder of ``trials plan``."""
    interim: bool = False
    """Show what there is before all trials are recorded."""
    json: bool = False
    """Print JSON instead of lines."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json, print_table
        from taccel_lab.tasks.robot_trials import read_trials
        from taccel_lab.tasks.trial_summary import summarise

        summary = summarise(read_trials(self.folder), interim=self.interim)
        if self.json:
            print_json(summary.table())
            return
        _tell(f"{summary.task}: {summary.recorded} of {summary.planned} trials")
        rows = [
            (r.policy, f"{r.successes} of {r.trials}", f"{r.rate:.1%}", _range(r.interval_95),
             str(r.voids))
            for r in summary.rates
        ]  # fmt: skip
        print_table(("policy", "success", "rate", "95 % (Wilson)", "repeated"), rows)
        for one in summary.comparisons:
            first, second = one.policies
            _tell(
                f"{first} against {second} from the same starts: both {one.both}, only {first} "
                f"{one.only_first}, only {second} {one.only_second}, neither {one.neither}; "
                f"difference {one.difference:+.1%} (95 %: {_range(one.interval_95)}), "
                f"p = {one.p_value:.3g}"
            )


def _range(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.1%} to {interval[1]:.1%}"


def _tell(line: str) -> None:
    """Write a line of results, however long."""
    from taccel_lab.cli.console import results

    results().print(line, soft_wrap=True, markup=False, highlight=False)
