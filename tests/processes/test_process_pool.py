# SPDX-License-Identifier: Apache-2.0
"""Child processes, where they keep their caches, and Warp's start."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from taccel_lab.cli.doctor import describe_machine
from taccel_lab.processes.child_process import ChildProcess
from taccel_lab.processes.process_pool import Finished, ProcessPool, Underway, usable_cores
from taccel_lab.progress import Progress
from taccel_lab.report.machine import describe_run


def patient(item: Path, told: Progress) -> int:
    """Says its process, and ends when the file is there."""
    told(str(os.getpid()), 0, 1)
    while not item.exists():
        time.sleep(0.01)
    return os.getpid()


@pytest.mark.thorough
def test_signals_to_all_processes_of_a_job_are_the_parents(tmp_path: Path) -> None:
    with ProcessPool(patient, 1) as pool:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2):
            item = tmp_path / str(number)
            events = pool.run([item])
            first = next(events)
            assert isinstance(first, Underway)
            os.kill(int(first.what), number)
            time.sleep(0.1)
            item.touch()
            last = next(events)
            assert isinstance(last, Finished) and last.result == int(first.what), number


def full(item: str, told: Progress) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), item)


@pytest.mark.thorough(cases=("1",))
@pytest.mark.parametrize("processes", [0, 1])
def test_a_full_disk_is_no_process_that_died(
    processes: int, capfd: pytest.CaptureFixture[str]
) -> None:
    with ProcessPool(full, processes) as pool, pytest.raises(OSError) as told:
        list(pool.run(["a", "b"]))
    assert (told.value.errno, told.value.filename) == (errno.ENOSPC, "a")
    assert "Traceback" not in capfd.readouterr().err


def answer(pipe: Connection) -> None:
    pipe.send("here")


def test_signals_while_a_process_starts_are_the_parents() -> None:
    child = ChildProcess(answer)
    for _ in range(20):
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(child._process.pid, number)
        if child.pipe.poll(0.02):
            break
    assert child.pipe.poll(60) and child.pipe.recv() == "here"
    child.end()


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


def test_without_bounds_all_cores_of_the_machine_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on macOS."""
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 12)
    for name in ("SLURM_CPUS_PER_TASK", "SLURM_CPUS_ON_NODE"):
        monkeypatch.delenv(name, raising=False)
    assert usable_cores() == 12
    assert describe_machine()["cores"] == describe_run()["cores"] == 12


# Caches -------------------------------------------------------------------------------------------


PROGRAM = """
import pwd

def nobody(uid):
    raise KeyError(uid)

pwd.getpwuid = nobody  # As for a user whom a container does not know.
import warp as wp
from taccel_lab.processes.cache_place import cache_folder
from taccel_lab.errors import InputError
from taccel_lab.model.launches import require_device

wp.config.log_level = wp.LOG_ERROR
for place in (lambda: require_device("cpu") and wp.config.kernel_cache_dir, cache_folder):
    try:
        print(place())
    except InputError as error:
        print(error)
"""
NO_HOME = "there is no home folder to keep .*; set TACCEL_LAB_CACHE to a folder"


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("variables", "kernels", "results"),
    [
        ({"TACCEL_LAB_CACHE": "ours", "HOME": "/proc/nowhere"}, "/ours/warp/", "ours"),
        ({"TACCEL_LAB_CACHE": "ours", "WARP_CACHE_PATH": "w"}, "/w/", "ours"),
        ({"XDG_CACHE_HOME": "x"}, "x/warp/", "x/taccel_lab"),
        ({"XDG_CACHE_HOME": "", "HOME": "h"}, "h/.cache/warp/", "h/.cache/taccel_lab"),
        ({}, NO_HOME, NO_HOME),
        (
            {"HOME": "/proc/nowhere"},
            "Warp cannot keep its kernels in /proc/nowhere.*; set TACCEL_LAB_CACHE to a folder",
            "/proc/nowhere/.cache/taccel_lab",
        ),
    ],
)
def test_kernels_and_results_lie_where_the_environment_says(
    variables: dict[str, str], kernels: str, results: str, tmp_path: Path
) -> None:
    named = ("HOME", "XDG_CACHE_HOME", "WARP_CACHE_PATH", "TACCEL_LAB_CACHE")
    kept = {name: value for name, value in os.environ.items() if name not in named}
    paths = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**kept, **paths, **variables},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    first, second = run.stdout.splitlines()
    assert re.search(kernels, first) and re.search(results, second)
    allowed = {value.split("/")[0] for value in variables.values()}
    assert {path.name for path in tmp_path.iterdir()} <= allowed


@pytest.mark.thorough
def test_a_command_without_a_home_folder_says_nothing_of_fonts(tmp_path: Path) -> None:
    """Matplotlib's list of fonts lies in the cache folder; drawing made it anew, and said so."""
    variables = {"TACCEL_LAB_CACHE": str(tmp_path / "ours"), "HOME": "/proc/nowhere"}
    kept = {name: value for name, value in os.environ.items() if name != "MPLCONFIGDIR"}
    words = "sensors show digit --picture".split()
    run = subprocess.run(
        [sys.executable, "-m", "taccel_lab.cli.app", *words, str(tmp_path / "shown.png")],
        env={**kept, **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "atplotlib" not in run.stderr
    assert list((tmp_path / "ours" / "matplotlib").glob("fontlist*"))


# Warp ---------------------------------------------------------------------------------------------


BEGUN_WITH = {
    "a scene": "tl.profile_scene(tl.load_sensor('flat_pad'), env_count=1).finalize('cpu')",
    "the optical model": (
        "p = tl.load_sensor('digit')\n"
        "tl.OpticalModel(p.optical_design(), p.mesh, size_px=(40, 30)).render()"
    ),
    "the resting face": (
        "from taccel_lab.signals.rest_surface import rest_surface\n"
        "p = tl.load_sensor('digit')\n"
        "rest_surface(p.mesh, p.grid())"
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("script", BEGUN_WITH.values(), ids=BEGUN_WITH)
def test_a_script_sees_no_lines_of_warp(script: str) -> None:
    words = [sys.executable, "-c", f"import taccel_lab as tl\n{script}"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (done.stdout, done.stderr) == ("", "")
