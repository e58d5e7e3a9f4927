# SPDX-License-Identifier: Apache-2.0
"""What the tests of bad input share: sound inputs to spoil, earlier outputs, and no work done.

Every case runs the whole command line with two targets: one that is not there, of which nothing
may remain, and one with an earlier output, which may not change by a byte. No simulation, fit or
mesh may begin.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from taccel_lab.output import OUTPUT_MARKER
from tests.cli.small_captures import never, write_captures, write_profile


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever takes long fails the test."""
    monkeypatch.setattr("taccel_lab.solvers.SolverIPC.step", never)
    monkeypatch.setattr("taccel_lab.calibration.color.fit.fit_color", never)
    monkeypatch.setattr("taccel_lab.cad.parts.pad_solid.labelled_solid", never)


@pytest.fixture(scope="session")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("originals")
    write_captures(folder / "captures")
    write_profile(folder / "profile")
    return folder


@pytest.fixture
def here(originals: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_work: None) -> Path:
    """A working folder with sound ``captures`` and ``profile`` and earlier outputs."""
    shutil.copytree(originals, tmp_path, dirs_exist_ok=True)
    (tmp_path / "earlier").mkdir()
    (tmp_path / "earlier" / OUTPUT_MARKER).touch()
    (tmp_path / "earlier" / "press.json").write_text("{}")
    shutil.copytree(originals / "profile", tmp_path / "earlier_profile")
    monkeypatch.chdir(tmp_path)
    return tmp_path
