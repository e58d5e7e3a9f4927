# SPDX-License-Identifier: Apache-2.0
"""What the tests of bad input share: sound inputs to spoil, earlier outputs, and no work done.

Every case runs the whole command line with an earlier output as target, which may not change by a
byte; one case of each command also with a target that is not there, of which nothing may remain.
No simulation, fit or mesh may begin.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.profile import save_profile
from tests.calibration.judged_once import detect_once, judge_slopes_once
from tests.sensors.imported_profiles import imported
from tests.support.commands import Done, done, refusal
from tests.support.small_captures import never, write_captures, write_profile
from tests.support.synthetic_presses import synthetic_captures
from tests.support.synthetic_presses import write_captures as save_captures


@pytest.fixture(scope="session", autouse=True)
def _all_imported() -> None:
    """Commands import as late as they can: what is first imported while a test has replaced a
    function would keep the replacement in every later test of the process."""
    for room in ("calibration", "cad", "cli", "presses", "sensors", "studies"):
        package = importlib.import_module(f"taccel_lab.{room}")
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)


@pytest.fixture(scope="session", autouse=True)
def _equal_captures_are_judged_once(_all_imported: None) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        detect_once(patch)
        judge_slopes_once(patch)
        yield


@pytest.fixture(scope="module", autouse=True)
def _figures_are_drawn_in_this_process() -> Iterator[None]:
    """A press draws in a process beside it, which takes longer to load than these presses take. Of
    each module, as files of other folders follow in the same process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("taccel_lab.processes.process_pool.usable_cores", lambda: 1)
        yield


class Cli:
    """Runs ``taccel-lab`` in this process; the first argument may be several words."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.capsys = capsys

    def __call__(self, command: str, *words: object, code: int = 0) -> Done:
        """What it printed; it has to end with ``code``."""
        found = done(self.capsys, *command.split(), *words)
        assert found.code == code, found.err
        return found

    def json(self, command: str, *words: object, code: int = 0) -> Any:
        """What it printed with ``--json``."""
        return json.loads(self(command, *words, "--json", code=code).out)

    def refusal(self, command: str, *words: object) -> str:
        """The sentence with which it refuses bad input, in one line."""
        return refusal(self.capsys, *command.split(), *words)


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    return Cli(capsys)


@pytest.fixture
def forbid(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Make a function, by its full name, fail the test wherever it is called from."""

    def forbid(name: str) -> None:
        home, _, function = name.rpartition(".")
        forbidden = getattr(importlib.import_module(home), function)
        for module_name, module in list(sys.modules.items()):
            if module_name.startswith("taccel_lab") and vars(module).get(function) is forbidden:
                monkeypatch.setattr(module, function, never)

    return forbid


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch, forbid: Callable[[str], None]) -> None:
    """Whatever takes long fails the test."""
    monkeypatch.setattr("taccel_lab.solvers.SolverIPC.step", never)
    forbid("taccel_lab.calibration.color.fit.fit_color")
    forbid("taccel_lab.cad.parts.pad_solid.labelled_solid")


@pytest.fixture(scope="session")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("originals")
    write_captures(folder / "captures")
    write_profile(folder / "profile")
    return folder


STUDY = """
[study]
name = "two"
sensor = "flat_pad"
metrics = ["pixel_size"]
[sweep]
kind = "grid"
[parameters.mm_per_px]
values = [0.05, 0.06]
"""


@pytest.fixture(scope="session")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Sound inputs by the words that stand for them in tables of commands."""
    folder = tmp_path_factory.mktemp("places")
    save_profile(imported(), folder / "profile")
    captures = save_captures(folder / "captures", synthetic_captures(count=3)[0])
    (folder / "study.toml").write_text(STUDY)
    return {
        "PROFILE": str(folder / "profile"),
        "CAPTURES": str(captures),
        "IMAGE": str(captures / "background.png"),
        "STUDY": str(folder / "study.toml"),
    }


@pytest.fixture
def here(originals: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_work: None) -> Path:
    """A working folder with sound ``captures`` and ``profile`` and earlier outputs."""
    shutil.copytree(originals, tmp_path, dirs_exist_ok=True)
    with atomic_directory(tmp_path / "earlier") as earlier:
        (earlier / "press.json").write_text("{}")
    shutil.copytree(originals / "profile", tmp_path / "earlier_profile")
    monkeypatch.chdir(tmp_path)
    return tmp_path
