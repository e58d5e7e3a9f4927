# SPDX-License-Identifier: Apache-2.0
"""What tests of commands share: a runner, and a folder of sound inputs that no refusal changes."""

from __future__ import annotations

import importlib
import json
import pkgutil
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista

from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.profile import save_profile
from taccel_lab.studies.spec.study import Kit
from tests.calibration.judged_once import detect_once, judge_slopes_once
from tests.calibration.record.sessions import source
from tests.fuzz.samples.profiles import with_force
from tests.support.commands import Done, done, refusal
from tests.support.fake_kit import METRICS, PRESSES, evaluate
from tests.support.small_captures import (
    everything_below,
    never,
    write_captures,
    write_image,
    write_profile,
)
from tests.support.synthetic_presses import GRID, flat_profile


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

    def refuses(self, says: list[str], command: str, *words: object) -> None:
        """One sentence with all of ``says``, nothing printed, nothing changed in this folder."""
        before = everything_below(Path.cwd())
        found = self(command, *words, code=2)
        told = " ".join(found.err.split())
        assert "error: " in told and "Traceback" not in told and found.out == ""
        assert all(part in told for part in says), told
        assert everything_below(Path.cwd()) == before


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


STUDY = (
    '[study]\nname = "Thickness"\nsensor = "gelsight"\nmetrics = ["stiffness", "range"]\n'
    "[parameters.thickness_mm]\nvalues = [4.0, 5.0, 6.0]\n"
    '[sweep]\nkind = "grid"\n'
    "[output]\nmeshes = false\npictures = false\n"
)
DATASET = (
    '[dataset]\nname = "one"\nepisodes = 1\nview = 0.2\naccuracy = "fast"\n'
    '[[sensors]]\nprofile = "flat_pad"\n'
    '[[objects]]\ntool = "sphere:2"\n'
    '[[motions]]\nkind = "press"\ndepth_mm = [0.1, 0.1]\n'
    '[output]\nchannels = ["depth_mm", "patch_forces_n"]\nsize_px = [32, 24]\n'
)


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sound inputs of all commands, an earlier output, and files of somebody else."""
    room = tmp_path_factory.mktemp("room")
    write_captures(room / "captures")
    write_profile(room / "profile")
    save_profile(flat_profile(GRID), room / "bare")
    (room / "touch").mkdir()
    with_force(room / "touch")
    source(room / "set", 2)
    for name in ("empty", "mine", "records", "boardless"):
        (room / name).mkdir()
    (room / "mine" / "notes.txt").write_text("mine")
    for name in ("plain/bg", "plain/a", "plain/b", "boardless/b"):
        (room / name).parent.mkdir(exist_ok=True)
        write_image(room / f"{name}.png", np.full((48, 64, 3), 90, np.uint8))
    (room / "boardless" / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight"\nbackground = "b.png"\n[[boards]]\n'
        'kind = "chessboard"\ncolumns = 7\nrows = 5\nimages = ["b.png"]\n'
    )
    (room / "records" / "press.csv").write_text("depth_mm,force_n\n0.2,0.1\n0.5,0.4\n0.8,0.9\n")
    (room / "records" / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight_mini"\n[[records]]\nfile = "press.csv"\n'
        'kind = "indentation"\ntool = { kind = "sphere", radius_mm = 5.0 }\n'
    )
    pyvista.Plane(i_size=3, j_size=3).triangulate().save(room / "plane.stl")
    (room / "study.toml").write_text(STUDY)
    (room / "rang.toml").write_text(STUDY.replace('"range"', '"rang"'))
    (room / "set.toml").write_text(DATASET)
    (room / "sizes.toml").write_text(DATASET + "sizes_px = [3, 4]\n")
    with atomic_directory(room / "earlier") as earlier:
        (earlier / "press.json").write_text("{}")
    return room


@pytest.fixture
def places(room: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Sound inputs by the words that stand for them in tables of commands; fakes press a study."""
    use(monkeypatch)
    return {
        "PROFILE": str(room / "profile"),
        "CAPTURES": str(room / "captures"),
        "IMAGE": str(room / "captures" / "background.png"),
        "STUDY": str(room / "study.toml"),
    }


@pytest.fixture
def here(room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with copies of ``captures`` and ``profile`` and earlier outputs of both."""
    for name, copy in (("captures",) * 2, ("profile",) * 2, ("profile", "earlier_profile")):
        shutil.copytree(room / name, tmp_path / copy)
    shutil.copytree(room / "earlier", tmp_path / "earlier")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study file in a folder of its own; fakes press, in this process."""
    use(monkeypatch)
    monkeypatch.setattr("taccel_lab.studies.evaluate.runner.default_processes", lambda device: 0)
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "thickness.toml"
    path.write_text(STUDY)
    return path


def use(monkeypatch: pytest.MonkeyPatch, how: Callable[..., Any] = evaluate) -> None:
    """Let fakes press for a study."""
    monkeypatch.setattr("taccel_lab.api.study.default_kit", lambda: Kit(PRESSES, METRICS, how))
