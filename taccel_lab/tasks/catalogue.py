# SPDX-License-Identifier: Apache-2.0
"""Tasks by name: a file of parameters each, the class that its ``kind`` names; seeds are run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_toml
from taccel_lab.guards import require_known
from taccel_lab.progress import Progress, silent
from taccel_lab.tasks.ball_rolling import BallRolling, BallRollingParameters
from taccel_lab.tasks.classification import Classification, ClassificationParameters
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.grasp_lift import (
    DrivenGraspLift,
    DrivenGraspParameters,
    GraspLift,
    GraspLiftParameters,
    SoftGraspParameters,
)
from taccel_lab.tasks.grasp_matrix import GraspMatrix, GraspMatrixParameters
from taccel_lab.tasks.nut import Nut, NutParameters
from taccel_lab.tasks.parameters import TaskParameters
from taccel_lab.tasks.peg_insertion import (
    PegFitParameters,
    PegInsertion,
    PegInsertionParameters,
)
from taccel_lab.tasks.result import TaskResult, TaskTrial
from taccel_lab.tasks.tac_man import TacMan, TacManParameters
from taccel_lab.tasks.throw_catch import ThrowCatch, ThrowCatchParameters
from taccel_lab.tasks.touch_insertion import TouchInsertion, TouchInsertionParameters
from taccel_lab.tasks.twist import Twist, TwistParameters

FILES = Path(__file__).parent / "files"
KINDS: dict[str, tuple[type[TaskParameters], type[TaskEpisode]]] = {
    "ball-rolling": (BallRollingParameters, BallRolling),
    "classification": (ClassificationParameters, Classification),
    "driven-grasp": (DrivenGraspParameters, DrivenGraspLift),
    "grasp-lift": (GraspLiftParameters, GraspLift),
    "grasp-matrix": (GraspMatrixParameters, GraspMatrix),
    "nut": (NutParameters, Nut),
    "peg-fit": (PegFitParameters, PegInsertion),
    "peg-insertion": (PegInsertionParameters, PegInsertion),
    "soft-grasp": (SoftGraspParameters, GraspLift),
    "tac-man": (TacManParameters, TacMan),
    "throw-catch": (ThrowCatchParameters, ThrowCatch),
    "touch-insertion": (TouchInsertionParameters, TouchInsertion),
    "twist": (TwistParameters, Twist),
}
"""The parameters and the class of each kind."""


@dataclass(frozen=True)
class Task:
    """A task: what its file says, and how it is begun."""

    name: str
    parameters: TaskParameters
    made_by: type[TaskEpisode]

    def begin(self, seeds: Sequence[int], device: str | None = None) -> TaskEpisode:
        """Seeds at their starts, as environments of one solver."""
        return self.made_by(self.parameters, seeds, device)  # type: ignore[call-arg, arg-type]


def names() -> list[str]:
    """Tasks of the package."""
    return sorted(path.stem for path in FILES.glob("*.toml"))


def named(name: str) -> Task:
    """A task of the package; InputError names those that there are."""
    require_known("task", name, names(), "taccel-lab task list")
    return read_task(FILES / f"{name}.toml")


def read_task(path: Path) -> Task:
    """The task of a file; InputError names the file and each wrong key."""
    table = read_toml(path)
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"{path}: kind must be one of {', '.join(KINDS)}, got {kind!r}")
    parameters, made_by = KINDS[kind]
    return Task(path.stem, parameters.checked(table, str(path)), made_by)


def run_task(
    task: Task,
    seeds: Sequence[int],
    device: str | None = None,
    *,
    steps: int | None = None,
    progress: Progress = silent,
) -> TaskResult:
    """Run seeds, ``parameters.environments`` of them at a time as environments of one solver.

    Ctrl-C ends the run after the last group that is finished; without one it goes on up.

    Args:
        task: The task.
        seeds: Each decides one start.
        device: "cpu" or "cuda:0"; as of ``Scene.finalize`` when None.
        steps: Steps to end after, for a try; the judgement is then of that moment.
        progress: Receives each step.
    """
    if not seeds:
        raise InputError("a run needs at least one seed")
    limit = steps or task.parameters.steps
    groups = task.made_by.groups(task.parameters, seeds)
    trials: list[TaskTrial] = []
    started = time.perf_counter()
    try:
        for number, group in enumerate(groups):
            episode = task.begin(group, device)
            while not episode.over and episode.taken < limit:
                episode.advance()
                progress(task.name, number * limit + episode.taken, len(groups) * limit)
            trials += episode.trials()
    except KeyboardInterrupt:
        if not trials:
            raise
    trials = task.made_by.conclude(task.parameters, trials, device)
    return TaskResult(task.name, trials, time.perf_counter() - started, len(seeds))
