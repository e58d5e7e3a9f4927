# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab trials``: from a plan to a summary."""

from __future__ import annotations

from pathlib import Path

from tests.cli.conftest import Cli


def test_trials_from_plan_to_summary(cli: Cli, tmp_path: Path) -> None:
    folder = tmp_path / "trials"
    words = ["trials plan peg-insertion --policies touch blind --starts 1 --seed 0 --out", folder]
    assert "2 trials in" in cli(*words).err
    assert "is there already" in cli.refusal(*words)
    assert cli.json("trials next", folder)["number"] == 1
    shown = cli("trials next", folder).out
    assert shown.startswith("trial 1 of 2: x_mm ") and "success: the peg's lowest" in shown
    policies = []
    for outcome in ("success", "failure"):
        policies.append(cli("trials next", folder, "--policy").out.strip())
        assert cli.json("trials record", folder, outcome)["outcome"] == outcome
        if outcome == "success":
            assert "--interim" in cli.refusal("trials summary", folder)
    assert sorted(policies) == ["blind", "touch"]
    assert "all 2 trials" in cli.refusal("trials next", folder)
    text = cli("trials summary", folder).out
    assert "1 of 1" in text and "blind against touch from the same starts" in text
    assert cli.json("trials summary", folder)["recorded"] == 2
