# SPDX-License-Identifier: Apache-2.0
"""What a path or a name stands for, by its content."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from taccel_lab.datasets.folder import ABOUT as DATASET
from taccel_lab.errors import InputError
from taccel_lab.sensors.registry import sensor_families
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.tasks.catalogue import names as task_names
from taccel_lab.tasks.replay import REPLAY
from taccel_lab.viewer.press_folder import PRESS


class Kind(StrEnum):
    """What there is to look at."""

    PROFILE = "profile"
    PRESS = "press"
    STUDY = "study"
    DATASET = "data set"
    REPLAY = "replay of a task"
    TASK = "live task"


@dataclass(frozen=True)
class Source:
    """A thing to look at."""

    kind: Kind
    name: str
    """The path or the name, as it was given."""

    @property
    def path(self) -> Path:
        return Path(self.name)


_MARKS = {
    Kind.PRESS: PRESS,
    Kind.DATASET: DATASET,
    Kind.REPLAY: REPLAY,
    Kind.PROFILE: "profile.toml",
}
"""The file by which a folder is known."""


def find_source(name: str) -> Source:
    """What ``name`` is: a folder that a command wrote, a sensor of the catalogue, a task.

    Raises:
        InputError: Nothing of these; says what there is and what would be needed.
    """
    path = Path(name)
    if path.is_dir():
        for kind, mark in _MARKS.items():
            if (path / mark).is_file():
                return Source(kind, name)
        if StudyFolder(path).is_study() or (path / "designs").is_dir():
            return Source(Kind.STUDY, name)
        if (path / "profile" / "profile.toml").is_file():
            return Source(Kind.PROFILE, str(path / "profile"))
        raise InputError(_nothing(path))
    if path.is_file():
        if path.suffix == ".toml" and path.name != "profile.toml":
            return Source(Kind.TASK, name)
        raise InputError(
            f"{path} is a file; name the folder that a command wrote, such as {path.parent}"
        )
    if name in sensor_families():
        return Source(Kind.PROFILE, name)
    if name in task_names():
        return Source(Kind.TASK, name)
    raise InputError(
        f"there is no folder, sensor or task {name!r}; sensors: "
        f"{', '.join(sensor_families())}; tasks: {', '.join(task_names())}"
    )


def _nothing(path: Path) -> str:
    """Why a folder cannot be shown, and what would be needed."""
    if (path / "result.json").is_file():
        return (
            f"{path} holds the figures of a task and no states: `taccel-lab task record TASK` "
            "keeps those of a seed, and `taccel-lab view TASK` runs one live"
        )
    marks = ", ".join(f"{mark} of a {kind}" for kind, mark in _MARKS.items())
    return f"{path} is nothing that can be looked at: it has neither {marks}, nor a study's designs"
