# SPDX-License-Identifier: Apache-2.0
"""Long steps say that they are alive also where no terminal draws a bar."""

from __future__ import annotations

import io
import threading
import time

import pytest
from rich.console import Console

from taccel_lab.cli import progress


def test_a_log_gets_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "BEAT_S", 0.05)
    log = Console(file=io.StringIO(), width=100)
    with progress.stage_progress(log) as stage:
        assert "reading ...\n" in log.file.getvalue()  # type: ignore[attr-defined]
        stage("finding boards", 1, 2)
        stage("fitting the lens", 4, 5)
        while "fitting the lens 4/5 (" not in log.file.getvalue():  # type: ignore[attr-defined]
            time.sleep(0.01)
    with pytest.raises(ValueError, match="x"), progress.stage_progress(log):
        raise ValueError("x")
    assert "progress" not in {thread.name for thread in threading.enumerate()}


def test_a_terminal_gets_bars_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "BEAT_S", 0.05)
    screen = Console(file=io.StringIO(), width=100, force_terminal=True)
    with progress.stage_progress(screen) as stage:
        stage("looking", 3, 7)
        time.sleep(0.2)
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    assert "reading ...\n" not in text and "3/7 (" not in text and "looking" in text
