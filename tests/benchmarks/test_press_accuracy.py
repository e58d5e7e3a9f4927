# SPDX-License-Identifier: Apache-2.0
"""What the suite press_accuracy measures, on its smallest scenes."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.benchmarks import press_accuracy
from taccel_lab.benchmarks.command_line import main
from taccel_lab.benchmarks.report.sections import VERIFICATION
from taccel_lab.benchmarks.results import read_result


def test_presses_of_a_sensor_are_compared_with_a_finer_mesh(tmp_path: Path) -> None:
    words = ["press_accuracy", "--quick", "--families", "flat_pad", "--out", str(tmp_path)]
    assert main([*words, "--tools", "ball 1.5"]) == 0
    document = read_result(tmp_path / "press_accuracy.json")
    shallow, deep = document["rows"]
    assert (shallow["depth_mm"], deep["depth_mm"]) == press_accuracy.DEPTHS_MM
    for row in (shallow, deep):
        assert row["cause"] == "" and row["nodes"] < row["converged_nodes"]
        assert 0 < abs(row["force_error"]) < row["estimated_force_error"] < 0.2
        assert 0 < row["height_rms_m"] < row["estimated_height_rms_m"] < 2e-5
        assert row["residual"] <= 1e-4
    for row in (shallow, deep):
        row["setting"] = "default"
    deep["cause"] = "unsolved"
    text = VERIFICATION["press accuracy"]({"press_accuracy": [document | {"file": "x.json"}]})
    assert "| ball 1.5, 0.1 mm | 1 |" in text and "1 of 2 cases did not converge" in text
    assert main([*words, "--tools", "hammer"]) == 2
    assert main(["press_accuracy", "--families", "no_such", "--out", str(tmp_path)]) == 2


def test_every_tool_meets_every_material() -> None:
    cases = list(press_accuracy.all_cases())
    for tool in press_accuracy.TOOLS:
        met = {(c.poisson_ratio, c.friction) for c in cases if c.tool == tool}
        assert met == set(press_accuracy.MATERIALS)
        assert press_accuracy.Case("flat_pad", tool, 0.1, 0.4, 0.0).indenter().contact(0.1)
