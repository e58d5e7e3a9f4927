# SPDX-License-Identifier: Apache-2.0
"""Work that a process beside does: done when finished, errors told, never lost with its process."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.processes import process_pool as module
from taccel_lab.processes.process_pool import Beside


def note(path: Path, text: str) -> None:
    path.write_text(f"{text} {os.getpid()}")


def refuse(text: str) -> None:
    raise InputError(text)


def die_but_here(parent: int, path: Path) -> None:
    if os.getpid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)
    note(path, "late")


def test_everything_is_done_elsewhere_and_in_turn(tmp_path: Path) -> None:
    with Beside() as beside:
        for text in ("first", "second"):
            beside.call(note, tmp_path / "note", text)
        beside.finish()
        words = (tmp_path / "note").read_text().split()
    assert words[0] == "second"
    assert (int(words[1]) != os.getpid()) == (module.usable_cores() > 1)


def test_an_error_is_told_and_the_next_call_goes_on(tmp_path: Path) -> None:
    with Beside() as beside:
        beside.call(refuse, "no such thing")
        with pytest.raises(InputError, match="no such thing"):
            beside.finish()
        beside.call(note, tmp_path / "note", "on")
        beside.finish()
    assert (tmp_path / "note").exists()


def test_what_its_process_died_of_is_done_here(tmp_path: Path) -> None:
    with Beside() as beside:
        beside.call(die_but_here, os.getpid(), tmp_path / "one")
        beside.call(note, tmp_path / "two", "later")
        beside.finish()
    for name in ("one", "two"):
        assert (tmp_path / name).read_text().endswith(str(os.getpid()))


def test_one_core_does_it_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "usable_cores", lambda: 1)
    with Beside() as beside:
        beside.call(note, tmp_path / "note", "now")
        assert (tmp_path / "note").read_text() == f"now {os.getpid()}"
