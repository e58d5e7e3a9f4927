# SPDX-License-Identifier: Apache-2.0
"""The suite ``readings`` on a small image."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from taccel_lab.benchmarks.results import read_result
from tests.support.commands import run
from tools.bench import readings
from tools.bench.__main__ import parse

ROOT = Path(__file__).parents[2]
ABSENT = ("tyro", "rich", "pyvista", "build123d", "OCP", "cv2", "kornia", "pydantic", "matplotlib")


@pytest.mark.thorough
def test_images_are_read_at_a_speed_and_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(readings, "SIZES", ((160, 128),))
    words = ["readings", "--at-once", "1", "2", "--repeats", "1", "--out", str(tmp_path)]
    assert run(*words, parsed=parse) == 0
    document = read_result(tmp_path / "readings.json")
    assert [row["at_once"] for row in document["rows"]] == [1, 2]
    for row in document["rows"]:
        assert 0 < row["off_mm_max"] < 0.01 < 0.3 < row["deepest_mm"]
        assert min(row[name]["images_per_s"] for name in ("heights", "heights and deviation")) > 0
    assert document["headline"]["aim_per_s"] == 20
    # One at a time a kept reader is timed, beside a small network.
    alone, together = document["rows"]
    for name in ("touched ms", "untouched ms", "small network ms"):
        assert alone[name]["median"] > 0 and name not in together


@pytest.mark.thorough
def test_only_warp_numpy_scipy_and_torch_are_needed() -> None:
    code = f"""
import sys
sys.modules.update(dict.fromkeys({ABSENT!r}))
from tools.bench import images, readings
assert readings.measure((96, 80), 2, "cpu", 1)["at_once"] == 2
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
