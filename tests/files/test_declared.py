# SPDX-License-Identifier: Apache-2.0
"""Files that state more than they hold are refused in a sentence, at once and in little memory."""

from __future__ import annotations

import resource
import time
from collections.abc import Hashable
from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.declared import require_few_copies, require_held
from tests.files.bombs import BOMBS
from tests.fuzz import memory

CPU_S, MEMORY_BYTES = 5.0, 1 << 29


def cpu_s() -> float:
    """CPU time of this process and of all that it started [s]."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime + memory.children_cpu_s()


@pytest.mark.thorough(
    cases=(
        "3mf-lies",
        "3mf-points",
        "hdf5-long-chunks",
        "lerobot-rows",
        "lerobot-times",
        "npz-zeros",
        "ply-list",
        "vtu-blocks",
        "xml-elements",
    )
)
@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", BOMBS)
def test_what_a_file_states_is_not_believed(name: str, tmp_path: Path) -> None:
    make, read = BOMBS[name]
    path = make(tmp_path)
    memory.begin()
    begun = cpu_s()
    with pytest.raises(InputError) as caught:
        read(path)
    assert cpu_s() - begun < CPU_S
    assert memory.taken() < MEMORY_BYTES
    said = str(caught.value)
    assert str(tmp_path) in said and len(said) < 500 and "\n" not in said


@pytest.mark.parametrize(
    ("parts", "roots", "limit", "allowed"),
    [
        ({}, ["a", "a"], 2, True),
        ({k: [k - 1, k - 1] for k in range(1, 6)}, [5], 63, True),
        ({k: [k - 1, k - 1] for k in range(1, 6)}, [5], 62, False),
        ({1: [2, 3], 2: [3]}, [1], 4, True),
        ({1: [3, 2], 2: [3], 3: [4]}, [1], 6, True),
        ({1: [3, 2], 2: [3], 3: [4]}, [1], 5, False),
        ({k: [k + 1] for k in range(100_000)}, [0], 100_001, True),
        ({k: [k - 1] * 1000 for k in range(1, 1000)}, [999], 10**6, False),
        ({1: [2], 2: [1]}, [1], 10**6, False),
        ({1: [1]}, [1], 10**6, False),
    ],
)
def test_parts_of_parts_are_counted_as_often_as_they_are_shown(
    parts: dict[Hashable, list[Hashable]], roots: list[Hashable], limit: int, allowed: bool
) -> None:
    if allowed:
        require_few_copies("a", parts, roots, limit)
        return
    with pytest.raises(InputError, match=f"a shows more than {limit:,} parts"):
        require_few_copies("a", parts, roots, limit)


def test_what_is_packed_may_be_so_many_times_as_large() -> None:
    require_held("a", "frames", 2200, 2, 1100)
    with pytest.raises(InputError, match=r"a states 2.15 KiB of frames, but holds 2 bytes, 1,100"):
        require_held("a", "frames", 2201, 2, 1100)
