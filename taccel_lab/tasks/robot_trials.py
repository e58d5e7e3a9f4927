# SPDX-License-Identifier: Apache-2.0
"""Trials on a real robot: starts that a task draws, in an order that hides the policy, one line a
trial.

``plan.json`` is what the person at the robot may see: the number and start of each trial.
``key.json`` is for the robot's program: the policy of each. ``trials.jsonl`` only grows.
"""

from __future__ import annotations

import fcntl
import json
import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Annotated

import numpy as np
from pydantic import AwareDatetime, Field, StringConstraints

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_bytes, write_json
from taccel_lab.files.documents import read_json, read_json_lines
from taccel_lab.files.images import read_image
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.files.strict_model import Number, StrictModel, Whole
from taccel_lab.guards import require_known, require_range
from taccel_lab.tasks.catalogue import Task
from taccel_lab.tasks.parameters import PlanarStart
from taccel_lab.tasks.trial_outcome import OUTCOMES, Outcome
from taccel_lab.version import __version__

PLAN, KEY, TRIALS, IMAGES = "plan.json", "key.json", "trials.jsonl", "images"
MOST_STARTS, MOST_POLICIES = 10_000, 26

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Line = Annotated[str, StringConstraints(max_length=500, pattern=r"^[^\x00-\x1f\x7f]*$")]
Count = Annotated[Whole, Field(ge=1, le=MOST_STARTS * MOST_POLICIES)]


class PlannedTrial(StrictModel):
    """A trial to come."""

    number: Count
    seed: Annotated[Whole, Field(ge=0)]
    """Seed of the task that draws this start."""
    start: dict[Name, Number]


class Plan(StrictModel):
    """What the person at the robot may see."""

    tool_version: str
    task: str
    criterion: str
    starts: Count
    trials: tuple[PlannedTrial, ...]


class Key(StrictModel):
    """What the robot's program alone may see."""

    order_seed: Whole
    policies: tuple[Name, ...]
    """Policy of each trial, in the order of their numbers."""


class Trial(StrictModel):
    """A line of ``trials.jsonl``."""

    number: Count
    outcome: Outcome
    note: Line = ""
    image: Line = ""
    """File in the folder, or nothing."""
    time: AwareDatetime = Field(strict=False)


@dataclass(frozen=True)
class TrialFolder:
    """A plan, its key and what is recorded."""

    root: Path
    plan: Plan
    key: Key
    trials: tuple[Trial, ...]
    """All lines, in the order in which they were written."""

    def standing(self) -> dict[int, Trial]:
        """The last line of each number."""
        return {trial.number: trial for trial in self.trials}

    def next(self) -> PlannedTrial | None:
        """The first trial without a success or a failure; None when all have one."""
        done = self.standing()
        for planned in self.plan.trials:
            if planned.number not in done or done[planned.number].outcome == "void":
                return planned
        return None

    def policy(self, number: int) -> str:
        """What is run in a trial."""
        return self.key.policies[number - 1]


def plan_trials(
    task: Task, policies: Sequence[str], starts: int, folder: Path | str, seed: int | None = None
) -> None:
    """Write a folder for trials: each policy from each start, in a drawn order.

    Args:
        task: Draws the starts: those of its seeds 0 to ``starts`` - 1, as in the simulation.
        policies: Their names.
        starts: Their number.
        folder: New folder.
        seed: Draws the order; a secret one when None.

    Raises:
        InputError: Bad names or numbers, a task without a planar start, or a folder that is there.
    """
    require_range("starts", starts, 1, MOST_STARTS)
    require_range("the number of policies", len(policies), 1, MOST_POLICIES)
    if len(set(policies)) < len(policies):
        raise InputError(f"policies need different names, got {', '.join(policies)}")
    drawn_from = getattr(task.parameters, "start", None)
    if not isinstance(drawn_from, PlanarStart):
        raise InputError(
            f"task {task.name!r} has no start in x, y and yaw that a person could lay out; "
            "take one of grasp-lift, peg-insertion, touch-insertion or a changed copy"
        )
    again = getattr(task.parameters, "drawn_again", None)
    found, _ = drawn_from.draw(range(starts), again)
    order_seed = secrets.randbits(32) if seed is None else seed
    rng = np.random.default_rng(order_seed)
    # The policies of one start follow one another: what drifts in a day is the same for them.
    drawn = [
        (k, policies[p]) for k in rng.permutation(starts) for p in rng.permutation(len(policies))
    ]
    trials = tuple(
        PlannedTrial(number=n, seed=int(k), start=found[k]) for n, (k, _) in enumerate(drawn, 1)
    )
    criterion = task.parameters.criterion
    key = Key.checked(
        {"order_seed": int(order_seed), "policies": tuple(name for _, name in drawn)}, "policies"
    )
    plan = Plan(
        tool_version=__version__, task=task.name, criterion=criterion, starts=starts, trials=trials
    )
    if Path(folder).exists():
        raise InputError(f"{folder} is there already; a plan is not changed, name a new folder")
    with atomic_directory(folder) as staging:
        write_json(staging / PLAN, plan.model_dump(mode="json"))
        write_json(staging / KEY, key.model_dump(mode="json"))
        write_bytes(staging / TRIALS, b"")


def read_trials(folder: Path | str) -> TrialFolder:
    """The plan and all that is recorded; InputError names the file and line at fault."""
    root = Path(folder)
    if not (root / PLAN).is_file():
        raise InputError(f"{root} has no {PLAN}; make one with taccel-lab trials plan")
    plan = Plan.checked(_listed(read_json(root / PLAN), "trials"), str(root / PLAN))
    key = Key.checked(_listed(read_json(root / KEY), "policies"), str(root / KEY))
    if [t.number for t in plan.trials] != [*range(1, len(key.policies) + 1)]:
        raise InputError(f"{root / PLAN} and {KEY} are not of the same trials")
    trials = tuple(
        Trial.checked(table, place.rstrip(",")) for place, table in read_json_lines(root / TRIALS)
    )
    for line, trial in enumerate(trials, 1):
        if trial.number > len(key.policies):
            raise InputError(
                f"{root / TRIALS}, line {line}: the plan has {len(key.policies)} trials, "
                f"got number {trial.number}"
            )
    return TrialFolder(root, plan, key, trials)


def record_trial(
    folder: Path | str,
    outcome: str,
    *,
    number: int | None = None,
    note: str = "",
    image: Path | None = None,
    correct: bool = False,
) -> Trial:
    """Append a trial; it is on disk when this returns.

    Args:
        folder: Of ``plan_trials``.
        outcome: "success", "failure", or "void" for one to be repeated, which needs a note.
        number: Its number, to be sure; the next one when None.
        note: What happened.
        image: A picture, which is copied into the folder.
        correct: Replace what stands for ``number``; the earlier line stays in the file.

    Raises:
        InputError: Another trial is next, nothing is left, no such outcome, or no image.
    """
    require_known("outcome", outcome, OUTCOMES)
    if outcome == "void" and not note.strip():
        raise InputError("a void trial needs a note that says what broke it")
    picture = None if image is None else _picture(image)
    with _alone(Path(folder)) as file:
        found = read_trials(folder)
        upcoming = found.next()
        if correct:
            if number not in found.standing() or not note.strip():
                raise InputError("a correction needs the number of a recorded trial and a note")
        elif upcoming is None:
            raise InputError(f"all {len(found.plan.trials)} trials of {folder} are recorded")
        elif number is not None and number != upcoming.number:
            raise InputError(f"trial {upcoming.number} is next, not {number}")
        number = number if number is not None else upcoming.number if upcoming else 0
        name = ""
        if picture is not None:
            name = f"{IMAGES}/{number:05d}_{len(found.trials):05d}{picture[0]}"
            (found.root / IMAGES).mkdir(exist_ok=True)
            write_bytes(found.root / name, picture[1])
        now = datetime.now(UTC).replace(microsecond=0)
        table = {"number": number, "outcome": outcome, "note": note, "image": name, "time": now}
        trial = Trial.checked(table, "trial")
        file.write(json.dumps(trial.model_dump(mode="json"), ensure_ascii=False) + "\n")
        file.flush()
        os.fsync(file.fileno())
    return trial


def _picture(path: Path) -> tuple[str, bytes]:
    """Suffix and bytes of an image that can be read."""
    read_image(path)
    return path.suffix.lower(), path.read_bytes()


@contextmanager
def _alone(folder: Path) -> Iterator[IO[str]]:
    """The file of trials, open for appending and locked, without a line that was cut short."""
    if not (folder / TRIALS).is_file():
        raise InputError(f"{folder} has no {TRIALS}; make one with taccel-lab trials plan")
    with open(folder / TRIALS, "r+", encoding="utf-8", newline="\n") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"another process records into {folder}; end it first") from None
        whole = (folder / TRIALS).read_bytes()
        os.truncate(file.fileno(), whole.rfind(b"\n") + 1)
        file.seek(0, os.SEEK_END)
        yield file


def _listed(table: Mapping[str, object], name: str) -> dict[str, object]:
    """A table whose list is a tuple, as frozen models hold it."""
    value = table.get(name)
    return {**table, name: tuple(value) if isinstance(value, list) else value}
