# SPDX-License-Identifier: Apache-2.0
"""Success rates and their intervals, against the formula and by hand."""

from __future__ import annotations

import json
import math

import pytest

from taccel_lab.errors import InputError
from taccel_lab.output import to_jsonable
from taccel_lab.tasks.result import TaskResult, Trial, success_interval

Z = 1.959963984540054


@pytest.mark.parametrize(("successes", "trials"), [(0, 5), (3, 7), (63, 64), (10, 10)])
def test_interval_is_wilsons(successes: int, trials: int) -> None:
    rate, low, high = success_interval(successes, trials)
    middle = (rate + Z**2 / (2 * trials)) / (1 + Z**2 / trials)
    spread = math.sqrt(rate * (1 - rate) / trials + Z**2 / (4 * trials**2))
    half = Z * spread / (1 + Z**2 / trials)
    assert rate == successes / trials
    assert (low, high) == pytest.approx((middle - half, middle + half), abs=1e-9)
    assert 0 <= low <= rate <= high <= 1 and low < high


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (3, 2), (-1, 4)])
def test_what_makes_no_rate_is_refused(successes: int, trials: int) -> None:
    with pytest.raises(InputError, match="make no rate"):
        success_interval(successes, trials)


def test_a_solver_failure_counts_as_failure_with_its_cause() -> None:
    trials = [
        Trial(0, True, "", 9, {"x_mm": 1.0}, {"slip_mm": 0.1}),
        Trial(1, False, "solver: NO_CONVERGENCE in step 4", 3, {"x_mm": 0.0}, {}),
        Trial(2, False, "rose by 1.0 mm", 9, {"x_mm": 2.0}, {"slip_mm": 0.3}),
        Trial(3, True, "", 9, {"x_mm": 2.0}, {"slip_mm": float("nan")}),
    ]
    table = TaskResult("lift", trials, 1.0, 6).table()
    assert (table["successes"], table["trials"], table["asked"]) == (2, 4, 6)
    assert table["success_rate"] == 0.5 and table["solver_failures"] == 1
    assert table["figures"]["slip_mm"]["median"] == pytest.approx(0.2)
    assert [row["cause"] for row in table["per_seed"]] == [trial.cause for trial in trials]
    assert json.loads(json.dumps(to_jsonable(table)))["per_seed"][3]["slip_mm"] is None


def test_cells_are_told_apart() -> None:
    trials = [
        Trial(0, True, "", 9, {}, {}, cell=("hand", "nut")),
        Trial(1, False, "slipped: rose by 1.0 mm", 9, {}, {}, cell=("hand", "nut")),
        Trial(2, False, "solver: OVERLAP in step 1", 0, {}, {}, cell=("claw", "nut")),
        Trial(3, False, "slipped: rose by 7.0 mm", 9, {}, {}, cell=("hand", "nut")),
    ]
    table = to_jsonable(TaskResult("lift", trials, 1.0, 4).table())
    first, second = table["cells"]
    assert first["cell"] == ["hand", "nut"] and first["causes"] == {"slipped": 2}
    assert (first["successes"], first["trials"]) == (1, 3)
    assert first["interval_95"] == list(success_interval(1, 3)[1:])
    assert second["success_rate"] == 0 and second["causes"] == {"solver": 1}
    assert [row["cell"][0] for row in table["per_seed"]] == ["hand", "hand", "claw", "hand"]
    assert "cells" not in TaskResult("lift", [Trial(0, True, "", 9, {}, {})], 1.0, 1).table()
