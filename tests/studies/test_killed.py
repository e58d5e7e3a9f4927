# SPDX-License-Identifier: Apache-2.0
"""A study that is killed at any time goes on where it was, and loses nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from taccel_lab.studies.design_row import DesignRow
from taccel_lab.studies.runner import run_study
from taccel_lab.studies.study_folder import RESULT, StudyFolder
from tests.studies.run_fake import CHANGES
from tests.support.fake_kit import logged, study

ROOT = Path(__file__).parents[2]


def children_of(pid: int) -> list[int]:
    path = Path(f"/proc/{pid}/task/{pid}/children")
    return (
        [int(child) for child in path.read_text(encoding="utf-8").split()] if path.is_file() else []
    )


@pytest.mark.parametrize("processes", [0, 2])
def test_a_killed_sweep_goes_on(tmp_path: Path, processes: int) -> None:
    folder = StudyFolder(tmp_path)
    command = [sys.executable, "-m", "tests.studies.run_fake", str(tmp_path), str(processes)]
    environment = {**os.environ, "FAKE_HOLD_AT": "8", "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, cwd=ROOT, env=environment)
    try:
        while len(folder.ids()) < 4:
            assert process.poll() is None
            time.sleep(0.02)
        children = children_of(process.pid)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    if processes:
        assert children
        while any(Path(f"/proc/{child}").exists() for child in children):
            time.sleep(0.02)
    before = {name: (folder.design(name) / RESULT).read_bytes() for name in folder.ids()}
    assert 4 <= len(before) < 12

    outcome = run_study(study(**CHANGES), tmp_path, processes=0)
    assert outcome.complete and len(outcome.rows) == 12
    assert outcome.new == 12 - len(before)
    for name, content in before.items():
        assert (folder.design(name) / RESULT).read_bytes() == content
        assert logged(tmp_path).count(name) == 1
    assert {row.id for row in outcome.rows} == {p.id for p in study(**CHANGES).points()}


def test_leftovers_of_a_killed_write_are_removed(tmp_path: Path) -> None:
    outcome = run_study(study(), tmp_path, processes=0)
    design = outcome.folder.design(outcome.rows[0].id)
    leftovers = [tmp_path / ".designs.x1.csv", design / ".result.y2.json"]
    (tmp_path / "meshes").mkdir()
    leftovers.append(tmp_path / "meshes" / ".half.vtu")
    for path in leftovers:
        path.write_text("half")
    run_study(study(), tmp_path, processes=0)
    assert not any(path.exists() for path in leftovers)


def test_a_merged_row_keeps_what_only_one_knows() -> None:
    old = DesignRow(
        "x", "gelsight", {}, "done", {"a": 1.0, "b": None}, {"b": "no edge", "press ball": "stuck"},
        2.0, 3, {"ball": [1]}, {"a": "k", "b": "k"}, {"ball": "k"}, {"mesh": "mesh.vtu"},
    )  # fmt: skip
    new = DesignRow(
        "x", "gelsight", {}, "failed", {"c": None}, {"c": "why"}, 1.0, 1, {}, {"c": "k"},
        {"ball": "k2"},
    )  # fmt: skip
    merged = old.merged(new)
    assert merged.status == "done"
    assert merged.figures == {"a": 1.0, "b": None, "c": None}
    assert merged.causes == {"b": "no edge", "c": "why"}
    assert (merged.seconds, merged.simulations) == (3.0, 4)
    assert merged.figure_keys == {"a": "k", "b": "k", "c": "k"}
    assert merged.press_keys == {"ball": "k2"}
    assert merged.files == {"mesh": "mesh.vtu"}
