# SPDX-License-Identifier: Apache-2.0
"""Kernels that Warp has kept and that were damaged since, or cannot keep."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

PROGRAM = """
import warp as wp
from taccel_lab.processes.start_warp import start_warp

start_warp()

@wp.kernel
def add_one(values: wp.array(dtype=float)):
    values[wp.tid()] += 1.0

values = wp.zeros(3, dtype=float, device="cpu")
wp.launch(add_one, 3, [values], device="cpu")
print(values.numpy().sum())
"""
DAMAGE: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "cut short": ("*.o", lambda found: found[: len(found) // 2]),
    "empty": ("*.o", lambda found: b""),
    "something else": ("*.o", lambda found: bytes(range(256)) * 10),
    "torn description": ("*.meta", lambda found: found[:5]),
}


def ended(program: Path, cache: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"WARP_CACHE_PATH": str(cache)}
    words = [sys.executable, str(program)]
    return subprocess.run(words, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.thorough
def test_damaged_kernels_are_named_and_made_again(tmp_path: Path) -> None:
    program, cache = tmp_path / "program.py", tmp_path / "cache"
    program.write_text(PROGRAM, encoding="utf-8")
    assert ended(program, cache).stdout == "3.0\n"
    for pattern, damaged in DAMAGE.values():
        (file,) = cache.rglob(pattern)
        file.write_bytes(damaged(file.read_bytes()))
        again = ended(program, cache)
        assert again.stdout == "3.0\n"
        assert f"kept kernels {file.parent} are damaged" in again.stderr
        assert "made again" in again.stderr and "Traceback" not in again.stderr
    assert ended(program, cache).stderr == ""


@pytest.mark.thorough
def test_where_none_can_be_kept_is_said_in_a_sentence(tmp_path: Path) -> None:
    """Files stand where the folders of the cache, of Warp's version and of the module have to."""
    program, cache = tmp_path / "program.py", tmp_path / "cache"
    program.write_text(PROGRAM, encoding="utf-8")
    ended(program, cache)
    (module,) = cache.glob("*/wp_*")
    for place in (module, module.parent, cache):
        shutil.rmtree(place)
        place.touch()
        said = ended(program, cache).stderr.splitlines()[-1]
        assert f"InputError: Warp cannot keep its kernels in {place}" in said
        assert said.endswith("; set WARP_CACHE_PATH to a folder that can be written")
