# SPDX-License-Identifier: Apache-2.0
"""Steps that are recorded and taken again."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.benchmarks.results import read_result
from tests.support.commands import done, run
from tools.bench.__main__ import parse
from tools.bench.slow_steps import COLUMNS

COARSE = ["--source", "generated"]


@pytest.mark.thorough
def test_steps_taken_again_take_as_long_and_end_in_the_same_place(tmp_path: Path) -> None:
    starts, out = tmp_path / "starts.npz", tmp_path / "out"
    words = ["slow_steps", "--starts", str(starts), "--out", str(out), *COARSE, "--slow", "12"]
    assert run(*words, "--envs", 2, "--steps", 30, "--share", 0.2, parsed=parse) == 0
    first = starts.read_bytes()
    rows = read_result(out / "slow_steps.json")["rows"]
    assert sum(row["steps"] for row in rows) == len(np.load(starts)["newton"]) > 4
    for row in rows:
        assert row["again"] == row["recorded"]
        assert row["moved_um_p95"] == row["failed"] == row["halved"] == 0
    tight = [*words, "--set", "relative_tolerance=1e-6"]
    assert run(*tight, parsed=parse) == 0 and starts.read_bytes() == first
    again = read_result(out / "slow_steps.json")["rows"]
    for row, loose in zip(again, rows, strict=True):
        assert (
            row["again"]["mean"] > loose["again"]["mean"] and row["recorded"] == loose["recorded"]
        )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"newton": None}, "lacks newton"),
        ({"positions": np.zeros((1, 3, 3))}, "holds positions of shape .*: record its own steps"),
        ({"targets": np.full((1, 3, 7), np.nan)}, "targets"),
    ],
)
def test_files_of_other_steps_are_refused(
    change: dict[str, np.ndarray | None],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arrays = dict.fromkeys(COLUMNS, np.zeros((1, 3, 7))) | change
    starts = tmp_path / "starts.npz"
    kept: dict[str, Any] = {name: array for name, array in arrays.items() if array is not None}
    np.savez(starts, **kept)
    given = ["slow_steps", "--starts", starts, "--out", tmp_path, *COARSE]
    code, _, err = done(capsys, *given, parsed=parse)
    assert code == 2 and re.search(words, err)
