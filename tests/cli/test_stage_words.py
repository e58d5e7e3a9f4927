# SPDX-License-Identifier: Apache-2.0
"""A command says which stage begins: a line of each in a log, with a clock in a terminal."""

from __future__ import annotations

import io
import time
from pathlib import Path

import pytest
import warp as wp
from rich.console import Console

from taccel_lab.cli.progress import stage_words
from taccel_lab.warp_output import first_step


@pytest.mark.parametrize("terminal", [False, True])
def test_every_stage_is_said(terminal: bool) -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=80)
    with stage_words(console) as say:
        for words in ("meshing", "meshing", "press [1]"):
            say(words)
            while terminal and words not in out.getvalue():
                time.sleep(0.01)
    assert "meshing" in out.getvalue() and "press [1]" in out.getvalue()
    if terminal:
        assert "0:00:0" in out.getvalue()
    else:
        assert out.getvalue() == "meshing ...\npress [1] ...\n"


def test_the_first_press_of_a_machine_says_what_takes_so_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    assert first_step().startswith("compiling the solver, once on this machine")
    (tmp_path / "wp_taccel_lab.solvers.start_step_617cc52").mkdir()
    assert first_step() == "first step"
