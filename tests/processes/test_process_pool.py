# SPDX-License-Identifier: Apache-2.0
"""Processes that work off items."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from taccel_lab.processes.process_pool import Finished, ProcessPool, Underway, usable_cores
from taccel_lab.progress import Progress


def patient(item: Path, told: Progress) -> int:
    """Says its process, and ends when the file is there."""
    told(str(os.getpid()), 0, 1)
    while not item.exists():
        time.sleep(0.01)
    return os.getpid()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2])
def test_signals_to_all_processes_of_a_job_are_the_parents(tmp_path: Path, number: int) -> None:
    item = tmp_path / "go"
    with ProcessPool(patient, 1) as pool:
        events = pool.run([item])
        first = next(events)
        assert isinstance(first, Underway)
        os.kill(int(first.what), number)
        time.sleep(0.1)
        item.touch()
        last = next(events)
    assert isinstance(last, Finished) and last.result == int(first.what)


def test_a_slurm_job_takes_the_cores_that_it_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(64)))
    for name in ("SLURM_CPUS_PER_TASK", "SLURM_CPUS_ON_NODE"):
        monkeypatch.delenv(name, raising=False)
    assert usable_cores() == 64
    monkeypatch.setenv("SLURM_CPUS_ON_NODE", "16")
    assert usable_cores() == 16
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "4")
    assert usable_cores() == 4
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "128")
    assert usable_cores() == 64
