# SPDX-License-Identifier: Apache-2.0
"""Folders that grow file by file: refused before any work where nothing can be written."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.output_folder import (
    atomic_directory,
    may_hold,
    require_growable,
    sweep_up,
)


def test_a_folder_that_grows_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for place in (tmp_path / "file", tmp_path / "file" / "inside"):
        with pytest.raises(InputError, match="file is a file; an output folder is needed"):
            require_growable(place)
    with pytest.raises(InputError, match="/proc/x cannot be written"):
        require_growable("/proc/x")
    (tmp_path / "begun").mkdir()
    before = sorted(tmp_path.rglob("*"))
    for place in (tmp_path / "begun", tmp_path / "new" / "one"):
        require_growable(place)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_full_drive_takes_no_more_of_a_folder_that_grows(small_drive: Path) -> None:
    (small_drive / "begun").mkdir()
    with suppress(OSError):
        (small_drive / "big").write_bytes(bytes(1_000_000))
    with pytest.raises(InputError, match="begun cannot be written: No space left on device"):
        require_growable(small_drive / "begun")


def test_a_folder_that_another_run_begins_at_this_moment_is_not_foreign(tmp_path: Path) -> None:
    assert may_hold(tmp_path / "new", "sign") and may_hold(tmp_path, "sign")
    (tmp_path / ".sign.half").write_text("half")
    assert may_hold(tmp_path, "sign")
    (tmp_path / "notes").write_text("mine")
    assert not may_hold(tmp_path, "sign")
    (tmp_path / "sign").write_text("whole")
    assert may_hold(tmp_path, "sign")


def test_what_ended_processes_left_is_swept_up(tmp_path: Path) -> None:
    """Not what a living one is writing, nor a folder of somebody else."""
    (tmp_path / ".a.taccel-lab-new-1" / "data").mkdir(parents=True)
    (tmp_path / "mine.taccel-lab-new-1").mkdir()
    with atomic_directory(tmp_path / "b") as staging:
        sweep_up(tmp_path)
        assert staging.is_dir()
    assert sorted(os.listdir(tmp_path)) == ["b", "mine.taccel-lab-new-1"]
    sweep_up(tmp_path / "none")
