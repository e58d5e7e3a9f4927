# SPDX-License-Identifier: Apache-2.0
"""A reader that crashes, hangs or takes all memory costs one file, never the process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.files import apart
from tests.files import foreign_readers as readers

NUMPY = f"numpy {version('numpy')}"
read_apart = partial(apart.read_apart, by="numpy")
stream_apart = partial(apart.stream_apart, by="numpy")


def test_results_come_back_from_a_process_that_stays() -> None:
    value = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(read_apart("a", readers.double, value), 2 * value)
    first, second = (read_apart("a", readers.process_number) for _ in range(2))
    assert first == second != os.getpid()


@pytest.mark.parametrize(
    ("read", "words"),
    [(readers.crash, f"{NUMPY} crashed on it (the process was ended by signal 6). The file"),
     (readers.leave, f"{NUMPY} crashed on it (the process ended with code 7). The file"),
     (readers.refuse, "^a.ply has no faces$"),
     (readers.take_memory, "needs more than 2 GiB of memory")],
)  # fmt: skip
def test_what_goes_wrong_is_a_sentence_and_the_next_file_is_read(
    read: Callable[[], None], words: str
) -> None:
    with pytest.raises(InputError, match=words.replace("(", r"\(").replace(")", r"\)")) as caught:
        read_apart("x.ply", read)
    assert "the file is damaged" not in str(caught.value)
    assert read_apart("a", readers.double, 2) == 4


def test_arrays_come_back_where_there_are_no_files_in_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(os, "memfd_create", raising=False)
    monkeypatch.setattr(apart, "_readers", apart._Readers())
    value = np.arange(1 << 20, dtype=np.float64).reshape(1024, 1024)
    try:
        for factor in (1, 2):
            np.testing.assert_array_equal(
                read_apart("a", readers.double, factor * value), 2 * factor * value
            )
    finally:
        apart._readers.end()


def test_relative_paths_are_those_of_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in (tmp_path, Path("/")):
        monkeypatch.chdir(folder)
        assert read_apart("a", os.getcwd) == str(folder)


def test_a_reader_that_hangs_is_ended() -> None:
    start = time.monotonic()
    with pytest.raises(InputError, match=r"^x\.ply: the reader did not finish within 0\.3 s"):
        read_apart("x.ply", readers.sleep, limit_s=0.3)
    assert time.monotonic() - start < 60  # It would sleep as long.
    assert read_apart("a", readers.double, 2) == 4


def test_a_mistake_of_ours_stays_one_and_tells_its_traceback() -> None:
    with pytest.raises(KeyError) as caught:
        read_apart("x.ply", readers.mistake)
    assert "in mistake" in caught.value.__notes__[0]


def test_streams() -> None:
    assert list(stream_apart("v", readers.count, 5)) == [0, 1, 2, 3, 4]
    assert list(stream_apart("v", readers.count, 0)) == []
    for read, words in ((readers.count_and_crash, "crashed"), (readers.count_and_refuse, "short")):
        seen = []
        with pytest.raises(InputError, match=words):
            for item in stream_apart("v", read, 3):
                seen.append(item)
        assert seen == [0, 1, 2]


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


def test_arrays_of_all_shapes_come_back() -> None:
    values = {
        "empty": np.zeros((0, 3)),
        "turned": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "strided": np.arange(100)[::7],
        "large": np.arange(5_000_000),
        "small": np.arange(3, dtype=np.uint8),
    }
    for _ in range(2):
        found = read_apart("a", readers.same, values)
        assert found.keys() == values.keys()
        for key, value in values.items():
            np.testing.assert_array_equal(found[key], value)
            assert found[key].flags.writeable


def test_an_error_that_does_not_pickle_is_told() -> None:
    with pytest.raises(RuntimeError, match="_OwnError: 3 and 4"):
        read_apart("x.ply", readers.own_error)
    assert read_apart("a", readers.double, 2) == 4


def test_streams_side_by_side_and_left_early() -> None:
    one, two = stream_apart("v", readers.count, 10**6), stream_apart("w", readers.count, 3)
    assert [next(one), next(two), next(one), next(two)] == [0, 0, 1, 1]
    one.close()
    assert list(two) == [2]
    assert read_apart("a", readers.double, 2) == 4


def test_a_plain_script_needs_no_guard_and_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import tests.files.foreign_readers as r\n"
        "from taccel_lab.files.apart import read_apart\n"
        "print(read_apart('a', r.process_number, by='numpy'), flush=True)\n"
        "read_apart('a', r.sleep, by='numpy')\n",
        encoding="utf-8",
    )
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
