# SPDX-License-Identifier: Apache-2.0
"""What a path or a name stands for, by its content; its page is opened and kept open."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.datasets.folder import ABOUT as DATASET
from taccel_lab.errors import InputError
from taccel_lab.guards import nearest
from taccel_lab.report.live_page import PageOptions, live_page, serve_until_stopped
from taccel_lab.sensors.registry import sensor_families
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.tasks.catalogue import names as task_names
from taccel_lab.tasks.replay import REPLAY
from taccel_lab.viewer.press_folder import PRESS

if TYPE_CHECKING:
    from viser import ViserServer


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
    known = (*sensor_families(), *task_names())
    lists = "taccel-lab sensors list and taccel-lab task list"
    raise InputError(
        f"there is no folder, sensor or task {name!r}{nearest(name, known)}; see {lists}"
    )


def _nothing(path: Path) -> str:
    """Why a folder cannot be shown, and what would be needed."""
    if (path / "result.json").is_file():
        return (
            f"{path} holds the figures of a task and no states: `taccel-lab task record TASK` "
            "keeps those of a seed, and `taccel-lab view TASK` runs one live"
        )
    marks = ", ".join(f"{mark} of a {kind}" for kind, mark in _MARKS.items())
    return f"{path} cannot be shown: it has neither {marks}, nor a study's designs"


@contextmanager
def source_page(
    source: Source,
    options: PageOptions,
    say: Callable[[str], None] | None = None,
    *,
    seed: int = 0,
    device: str = "cpu",
) -> Iterator[ViserServer]:
    """The page of a source while the block runs.

    Args:
        source: Of ``find_source``.
        options: Where it is served.
        say: Receives the address.
        seed: Start of a live task.
        device: Warp device of a live task.

    Raises:
        InputError: Files that are not as they should be, or as of ``live_page``.
    """
    read = _read(source)  # What cannot be read is rejected before a page opens.
    title = f"{source.kind}: {source.path.name or source.name}"
    with live_page(title, options, say) as server:
        close = _fill(server, source, read, seed, device)
        try:
            yield server
        finally:
            if close is not None:
                close()


def serve_source(
    source: Source,
    options: PageOptions,
    say: Callable[[str], None],
    *,
    seed: int = 0,
    device: str = "cpu",
) -> None:
    """Serves the page of ``source_page`` until KeyboardInterrupt."""
    with source_page(source, options, say, seed=seed, device=device):
        serve_until_stopped()


def _read(source: Source) -> Any:
    if source.kind is Kind.PROFILE:
        from taccel_lab.sensors.profile import stock_sensor

        return stock_sensor(source.name)
    if source.kind is Kind.DATASET:
        from taccel_lab.viewer.dataset_page import open_dataset

        return open_dataset([source.path])
    if source.kind is Kind.TASK:
        from taccel_lab.tasks.catalogue import named, read_task

        return read_task(source.path) if source.path.is_file() else named(source.name)
    if source.kind is Kind.PRESS:
        from taccel_lab.viewer.press_folder import read_press

        return read_press(source.path)
    return None


def _fill(
    server: ViserServer, source: Source, read: Any, seed: int, device: str
) -> Callable[[], None] | None:
    """Fill the page; returns what ends its threads."""
    if source.kind is Kind.PROFILE:
        from taccel_lab.viewer.profile_page import fill_profile_page

        fill_profile_page(server, read)
    elif source.kind is Kind.PRESS:
        from taccel_lab.viewer.press_folder import fill_press_page

        fill_press_page(server, source.path, read)
    elif source.kind is Kind.STUDY:
        from taccel_lab.viewer.study_page import StudyPage

        StudyPage(server, source.path)
    elif source.kind is Kind.DATASET:
        from taccel_lab.viewer.dataset_page import DatasetPage

        DatasetPage(server, read)
    elif source.kind is Kind.REPLAY:
        from taccel_lab.viewer.live_scene import fill_replay_page

        fill_replay_page(server, source.path)
    else:
        from taccel_lab.viewer.live_scene import LiveScene

        title = f"{read.name}, seed {seed}"
        return LiveScene(server, title, lambda: read.begin([seed], device)).close
    return None
