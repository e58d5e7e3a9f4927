# SPDX-License-Identifier: Apache-2.0
"""The suite ``press_accuracy`` on its smallest presses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.benchmarks import press_accuracy
from taccel_lab.benchmarks.results import read_result
from taccel_lab.presses import PHYSICS, Accuracy
from tests.support.commands import run
from tools.bench.report.sections import VERIFICATION


@pytest.mark.thorough
def test_presses_of_a_sensor_are_compared_with_a_finer_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    coarse = {**PHYSICS, Accuracy.DEFAULT: PHYSICS[Accuracy.FAST]}
    for name, value in (
        ("DEPTHS_MM", (0.1,)),
        ("NEARER", 2),
        ("RELAXING", ()),
        ("PHYSICS", coarse),
    ):
        monkeypatch.setattr(press_accuracy, name, value)
    words = ["press_accuracy", "--quick", "--families", "flat_pad", "--out", str(tmp_path)]
    assert run("bench", *words, "--tools", "ball 1.5") == 0
    document = read_result(tmp_path / "press_accuracy.json")
    fast, asked = document["rows"]
    assert (fast["setting"], asked["setting"]) == ("fast", "3%")
    for row in (fast, asked):
        assert row["cause"] == "" and row["depth_mm"] == 0.1
        assert 0 < abs(row["force_error"]) < row["estimated_force_error"] < 0.06
        assert 0 < row["height_rms_m"] < row["estimated_height_rms_m"] < 2e-5
        assert row["residual"] <= 1e-4
    document["rows"].append(fast | {"cause": "unsolved"})
    text = VERIFICATION["press accuracy"]({"press_accuracy": [document | {"file": "x.json"}]})
    assert "| fast, balls | 1 |" in text and "| 3%, balls | 1 |" in text
    assert "1 of 3 presses did not converge" in text


def test_every_tool_meets_every_material() -> None:
    cases = list(press_accuracy.all_cases())
    for tool in press_accuracy.TOOLS:
        met = {(c.poisson_ratio, c.friction) for c in cases if c.tool == tool}
        if tool in {"ball 1", "ball 0.5"}:  # Small balls are for thick pads.
            assert met == {(ratio, 0.0) for ratio in press_accuracy.PAD_RATIOS}
            continue
        assert met >= set(press_accuracy.MATERIALS)
        assert press_accuracy.PressCase("flat_pad", tool, 0.1, 0.4, 0.0).indenter().contact(0.1)


def test_errors_are_relative_to_the_converged_press(monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN where a pixel sees no gel."""
    seen = np.array([[0.0, 3e-6], [4e-6, np.nan]])
    figures = {"force_n": 2.1, "solved_n": 1.9}
    monkeypatch.setattr(press_accuracy, "measured_case", lambda *_: (figures, seen))
    true = press_accuracy.Truth(2.0, np.zeros((2, 2)), 7)
    monkeypatch.setattr(press_accuracy, "truth", lambda *_: true)
    row = press_accuracy.measure(next(press_accuracy.all_cases()), "fast", 0.5, "cpu")
    assert (row["force_error"], row["solved_error"]) == pytest.approx((0.05, -0.05))
    assert row["height_rms_m"] == pytest.approx(5e-6 / 3**0.5)
