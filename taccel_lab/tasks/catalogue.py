# SPDX-License-Identifier: Apache-2.0
"""Tasks by name: a file of parameters each, and the class that its ``kind`` names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.toml_file import read_toml
from taccel_lab.tasks.ball_rolling import BallRolling, BallRollingParameters
from taccel_lab.tasks.classification import Classification, ClassificationParameters
from taccel_lab.tasks.driven_grasp import DrivenGraspLift, DrivenGraspParameters
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.grasp_lift import GraspLift, GraspLiftParameters, SoftGraspParameters
from taccel_lab.tasks.grasp_matrix import GraspMatrix, GraspMatrixParameters
from taccel_lab.tasks.nut import Nut, NutParameters
from taccel_lab.tasks.parameters import TaskParameters
from taccel_lab.tasks.peg_insertion import (
    PegFitParameters,
    PegInsertion,
    PegInsertionParameters,
)
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
    if name not in names():
        raise InputError(f"there is no task {name!r}; there are {', '.join(names())}")
    return read_task(FILES / f"{name}.toml")


def read_task(path: Path) -> Task:
    """The task of a file; InputError names the file and each wrong key."""
    table = read_toml(path)
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"{path}: kind must be one of {', '.join(KINDS)}, got {kind!r}")
    parameters, made_by = KINDS[kind]
    return Task(path.stem, parameters.checked(table, str(path)), made_by)
