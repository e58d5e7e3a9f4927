# SPDX-License-Identifier: Apache-2.0
"""A disk that is full: said by name, and what stood there stays."""

from __future__ import annotations

import errno
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_by
from taccel_lab.files.output_folder import atomic_directory, require_replaceable
from taccel_lab.processes.cache_place import CACHE_VARIABLE


@pytest.mark.parametrize("how", ["file", "array"])
def test_a_full_disk_says_so_and_loses_nothing(small_drive: Path, how: str) -> None:
    target = small_drive / "out"
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text("old")
    before = {path: path.is_file() and path.read_bytes() for path in small_drive.rglob("*")}
    with (
        pytest.raises(OSError, match="No space left on device") as raised,
        atomic_directory(target) as folder,
    ):
        if how == "file":
            (folder / "a.txt").write_bytes(bytes(1_000_000))
        else:
            # numpy of its own tells neither the number nor the name.
            write_by(folder / "a.npy", lambda file: np.save(file, np.zeros(1_000_000)))
    assert raised.value.errno == errno.ENOSPC
    assert raised.value.filename == str(target)
    after = {path: path.is_file() and path.read_bytes() for path in small_drive.rglob("*")}
    assert after == before


def test_a_cache_that_is_full_is_not_the_output(
    small_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Libraries write into it without a word, such as Warp its kernels."""
    cache = small_drive / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(cache))
    with pytest.raises(OSError, match="No space left on device") as told:
        with atomic_directory(tmp_path / "out") as folder:
            (folder / "a.txt").write_text("there is room")
            (small_drive / "kernel").write_bytes(bytes(1_000_000))
    assert told.value.filename == str(cache)
    assert not (tmp_path / "out").exists()


def test_a_disk_that_is_full_already_is_refused_before_any_work(small_drive: Path) -> None:
    with suppress(OSError):
        (small_drive / "big").write_bytes(bytes(1_000_000))
    with pytest.raises(InputError, match="out cannot be written: No space left on device"):
        require_replaceable(small_drive / "out")
