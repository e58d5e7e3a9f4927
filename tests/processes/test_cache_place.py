# SPDX-License-Identifier: Apache-2.0
"""Kernels and results are kept where the user said, and nothing lands where nobody said."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import pwd

def nobody(uid):
    raise KeyError(uid)

pwd.getpwuid = nobody  # As for a user whom a container does not know.
import warp as wp
from taccel_lab.processes.cache_place import cache_folder
from taccel_lab.errors import InputError
from taccel_lab.model.devices import require_device

wp.config.log_level = wp.LOG_ERROR
for place in (lambda: require_device("cpu") and wp.config.kernel_cache_dir, cache_folder):
    try:
        print(place())
    except InputError as error:
        print(error)
"""
NO_HOME = "there is no home folder to keep .*; set TACCEL_LAB_CACHE to a folder"


@pytest.mark.parametrize(
    ("variables", "kernels", "results"),
    [
        ({"TACCEL_LAB_CACHE": "ours"}, "/ours/warp/", "ours"),
        ({"TACCEL_LAB_CACHE": "ours", "HOME": "/proc/nowhere"}, "/ours/warp/", "ours"),
        ({"TACCEL_LAB_CACHE": "ours", "WARP_CACHE_PATH": "w"}, "/w/", "ours"),
        ({"XDG_CACHE_HOME": "x"}, "x/warp/", "x/taccel_lab"),
        ({"XDG_CACHE_HOME": "", "HOME": "h"}, "h/.cache/warp/", "h/.cache/taccel_lab"),
        ({}, NO_HOME, NO_HOME),
        ({"XDG_CACHE_HOME": ""}, NO_HOME, NO_HOME),
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
