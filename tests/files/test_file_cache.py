# SPDX-License-Identifier: Apache-2.0
"""What is kept comes back to the bit, and any damage is told and made good."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from taccel_lab.files.file_cache import CACHE_VARIABLE, cached_arrays

ARRAYS = {"a": np.arange(12.0).reshape(3, 4), "b": np.array([1, 2, 3], dtype=np.int32)}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    return tmp_path


def agree(found: dict[str, np.ndarray] | None) -> bool:
    return found is not None and all(np.array_equal(found[name], ARRAYS[name]) for name in ARRAYS)


def test_made_once() -> None:
    file = cached_arrays("things", {"n": 1})
    assert file.read() is None
    assert agree(file.read_or_make(lambda: ARRAYS))
    assert agree(file.read_or_make(lambda: pytest.fail("it is there")))
    assert cached_arrays("things", {"n": 2}).read() is None


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_is_told_and_made_again(data: st.DataObject) -> None:
    file = cached_arrays("things", {"n": 1})
    file.write(ARRAYS)
    sound = file.path.read_bytes()
    damage = data.draw(st.sampled_from(["cut", "byte", "more", "other"]))
    if damage == "cut":
        spoilt = sound[: data.draw(st.integers(0, len(sound) - 1))]
    elif damage == "byte":
        place = data.draw(st.integers(0, len(sound) - 1))
        flipped = sound[place] ^ data.draw(st.integers(1, 255))
        spoilt = sound[:place] + bytes([flipped]) + sound[place + 1 :]
    else:
        extra = data.draw(st.binary(min_size=1, max_size=100))
        spoilt = sound + extra if damage == "more" else extra
    file.path.write_bytes(spoilt)
    with pytest.warns(UserWarning, match="kept things .* are damaged") as told:
        assert agree(file.read_or_make(lambda: ARRAYS))
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert agree(file.read())


def test_what_cannot_be_read_is_told() -> None:
    file = cached_arrays("things", {"n": 1})
    file.path.mkdir(parents=True)
    with pytest.warns(UserWarning, match="Is a directory"):
        assert file.read() is None


_MANY = """
import sys, warnings
import numpy as np
from taccel_lab.files.file_cache import cached_arrays
warnings.simplefilter("error")
for turn in range(40):
    for n in range(3):
        file = cached_arrays("things", {"n": n})
        found = file.read_or_make(lambda: {"a": np.full(5000, float(n))})
        assert (found["a"] == n).all(), (turn, n)
        if turn % 4 == int(sys.argv[1]):
            file.path.unlink(missing_ok=True)
"""


def test_processes_share_a_cache(folder: Path) -> None:
    """Four write, read and delete the same files: nobody meets a half-written one."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", _MANY, str(number)],
            env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
            stderr=subprocess.PIPE,
            text=True,
        )
        for number in range(4)
    ]
    for process in processes:
        _, said = process.communicate()
        assert process.returncode == 0, said
    left = [path.name for path in folder.rglob("*") if path.is_file()]
    assert len(left) <= 3, left
