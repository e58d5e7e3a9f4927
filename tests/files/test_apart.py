# SPDX-License-Identifier: Apache-2.0
"""Readers of libraries run in a process apart, which may crash, hang or fill."""

from __future__ import annotations

import copy
import operator
import os
import signal
import subprocess
import sys
import time
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.files import apart
from tests.files import foreign_readers as readers

NUMPY = f"numpy {version('numpy')}"
read_apart = partial(apart.read_apart, by="numpy")
stream_apart = partial(apart.stream_apart, by="numpy")


def require_works() -> None:
    """The next file is read, whatever the last one did."""
    assert read_apart("a", operator.mul, 2, 2) == 4


def test_results_come_back_from_a_process_that_stays() -> None:
    value = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(read_apart("a", operator.mul, value, 2), 2 * value)
    first, second = (read_apart("a", os.getpid) for _ in range(2))
    assert first == second != os.getpid()
    # A library of a pool apart leaves the other processes alone.
    own = read_apart("a", os.getpid, pool="own")
    assert own != first == read_apart("a", os.getpid)
    assert read_apart("a", os.getpid, pool="own") == own


@pytest.mark.thorough(cases=tuple("01"))
@pytest.mark.parametrize(
    ("call", "kind", "words"),
    [
        (
            (os.abort,),
            InputError,
            rf"{NUMPY} crashed on it \(the process was ended by signal 6\)\. T",
        ),
        (
            (os._exit, 7),
            InputError,
            rf"{NUMPY} crashed on it \(the process ended with code 7\)\. Th",
        ),
        ((readers.reserve, 8 << 30), InputError, "needs more than 2 GiB of memory"),
        ((readers.refuse,), InputError, "^a.ply has no faces$"),
        # One that does not pickle.
        ((readers.own_error,), RuntimeError, "_OwnError: 3 and 4"),
    ],
    ids="01234",
)
def test_what_goes_wrong_is_a_sentence_and_the_next_file_is_read(
    call: tuple[Any, ...], kind: type[Exception], words: str
) -> None:
    with pytest.raises(kind, match=words) as caught:
        read_apart("x.ply", *call)
    assert "the file is damaged" not in str(caught.value)
    require_works()


def test_nothing_that_a_reader_sends_runs_here(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"{NUMPY} gave what is no answer"):
        read_apart("x.ply", readers.send_a_pickle, str(tmp_path / "made"))
    assert not (tmp_path / "made").exists()
    with pytest.raises(TypeError, match="a builtin_function_or_method cannot be sent"):
        read_apart("x.ply", readers.unsendable)
    require_works()


def test_a_mistake_of_ours_stays_one_and_tells_its_traceback() -> None:
    with pytest.raises(KeyError) as caught:
        read_apart("x.ply", readers.mistake)
    assert "in mistake" in caught.value.__notes__[0]


@pytest.mark.thorough
def test_a_reader_that_never_ends_takes_what_its_file_is_worth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "CPU_S", 1.0)
    path = tmp_path / "a.ply"
    path.write_bytes(bytes(1000))
    said = rf"{path}: the reader did not finish within 1 s of the processor"
    with pytest.raises(InputError, match=said):
        read_apart(str(path), readers.spin)
    # Each item anew; so does each file.
    assert list(stream_apart(str(path), readers.items_of_work, 4)) == [0, 1, 2, 3]
    require_works()


@pytest.mark.thorough
def test_a_reader_that_hangs_is_ended() -> None:
    start = time.monotonic()
    with pytest.raises(InputError, match=r"^x\.ply: the reader did not finish within 0\.3 s"):
        read_apart("x.ply", time.sleep, 60, limit_s=0.3)
    assert time.monotonic() - start < 60
    require_works()


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["crash", "memory"])
def test_a_file_is_not_blamed_for_what_earlier_files_left(how: str) -> None:
    first, second = (read_apart("a", readers.harm, how) for _ in range(2))
    assert first != second
    (third,) = stream_apart("v", readers.harmed, how)
    assert third != second
    # Nor for what they took from the memory that its later items need: each item comes once.
    *whole, last = stream_apart("v", readers.harmed, how, 1, 2)
    assert whole == [1, 2] and last != third
    # Nor for a process that ended while it waited, as where a system runs out of memory.
    os.kill(read_apart("a", os.getpid), signal.SIGKILL)
    require_works()


def test_arrays_come_back_where_there_are_no_files_in_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(os, "memfd_create", raising=False)
    monkeypatch.setattr(apart, "_readers", apart._Readers())
    value = np.arange(1 << 20, dtype=np.float64).reshape(1024, 1024)
    try:
        for factor in (1, 2):
            found = read_apart("a", operator.mul, factor * value, 2)
            np.testing.assert_array_equal(found, 2 * factor * value)
    finally:
        apart._readers.end()


@pytest.mark.thorough
def test_arrays_of_all_shapes_come_back() -> None:
    values = {
        "empty": np.zeros((0, 3)),
        "turned": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "strided": np.arange(100)[::7],
        "large": np.arange(5_000_000),
        "small": np.arange(3, dtype=np.uint8),
    }
    for _ in range(2):
        found = read_apart("a", copy.copy, values)
        assert found.keys() == values.keys()
        for key, value in values.items():
            np.testing.assert_array_equal(found[key], value)
            assert found[key].flags.writeable


def test_relative_paths_are_those_of_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in (tmp_path, Path("/")):
        monkeypatch.chdir(folder)
        assert read_apart("a", os.getcwd) == str(folder)


@pytest.mark.thorough
def test_streams() -> None:
    assert list(stream_apart("v", range, 5)) == [0, 1, 2, 3, 4]
    assert list(stream_apart("v", range, 0)) == []
    for words in ("crashed", "short"):
        seen = []
        with pytest.raises(InputError, match=words):
            for item in stream_apart("v", readers.count_and, 3, words):
                seen.append(item)
        assert seen == [0, 1, 2]
    # Side by side, and one left early.
    one, two = stream_apart("v", range, 10**6), stream_apart("w", range, 3)
    assert [next(one), next(two), next(one), next(two)] == [0, 0, 1, 1]
    one.close()
    assert list(two) == [2]
    require_works()


def test_a_stream_is_read_one_ahead_and_no_further() -> None:
    """However slow the one who takes the items is."""
    stream = stream_apart("v", readers.times, 6)
    asked, made = [], []
    for _ in range(6):
        asked.append(time.monotonic())
        made.append(next(stream))
        time.sleep(0.1)
    # While one is taken the next is made, and the one behind that not before this was asked for.
    assert all(later > before for before, later in zip(asked[:-2], made[2:], strict=True))


SCRIPT = """
import os, time
from taccel_lab.files.apart import read_apart
print(read_apart('a', os.getpid, by='numpy'), flush=True)
read_apart('a', time.sleep, 60, by='numpy')
"""


@pytest.mark.thorough
def test_a_plain_script_needs_no_guard_and_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    run = subprocess.Popen(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        # Shells start what runs in the background with Ctrl-C ignored, which is inherited.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert run.stdout is not None
    child = int(run.stdout.readline())
    time.sleep(0.5)  # until it waits for the sleeper, as somebody who grows impatient
    run.send_signal(signal.SIGINT)
    assert run.wait(50) != 0
    with pytest.raises(ProcessLookupError):
        while True:
            os.kill(child, 0)
            time.sleep(0.05)
