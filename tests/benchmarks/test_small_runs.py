# SPDX-License-Identifier: Apache-2.0
"""Suites on their smallest scenes: multi_gpu with CPUs for GPUs, readings, press_accuracy."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.benchmarks import press_accuracy, readings
from taccel_lab.benchmarks.command_line import main, parse
from taccel_lab.benchmarks.report.sections import VERIFICATION
from taccel_lab.benchmarks.results import read_result
from taccel_lab.errors import InputError
from taccel_lab.presses import PHYSICS, Accuracy


def test_processes_do_the_same_steps_in_the_order_that_matters(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found.json"
    words = "--devices cpu cpu --counts 1 2 2 --envs 3 --steps 3 --warm-up 1 --repeats 1"
    command = ["multi_gpu", *words.split(), "--source", "generated", "--out", str(out)]
    assert main(command) == 0
    document = read_result(out)
    rows = document["rows"]
    assert [(r["scaling"], r["gpus"], r["envs"]) for r in rows] == [
        ("one GPU", 1, 3), ("strong", 2, 3), ("weak", 2, 6),
    ]  # fmt: skip
    for row in rows:
        assert row["env_steps"] == 3 * row["envs"] and row["unconverged"] == 0
        assert row["newton_differ"] == 0 and row["force_spread_n"] == 0
        assert row["newton_by_step"] == rows[0]["newton_by_step"]
        assert row["force_n"] == pytest.approx(rows[0]["force_n"], rel=1e-12)
        assert len(row["newton_mean_of_shards"]) == row["gpus"]
        assert 0 < row["worst_over_allowed"] <= 1
    assert sum(rows[0]["newton_by_step"]) > 3 and rows[0]["force_n"] > 0
    assert document["complete"] and json.dumps(document["run"])
    assert len(capsys.readouterr().err.splitlines()) == 1 + len(rows)


def test_wrong_options_are_refused(tmp_path: Path) -> None:
    out = ("--out", str(tmp_path / "found.json"))
    with pytest.raises(InputError, match="device 'cuda:77' is not here; devices are cpu"):
        parse(["multi_gpu", "--devices", "cuda:77", *out]).run()
    with pytest.raises(InputError, match="must be at least 1"):
        parse(["multi_gpu", "--devices", "cpu", "--envs", "0", *out]).run()
    assert not list(tmp_path.iterdir())


# Readings -----------------------------------------------------------------------------------------


def test_images_are_read_at_a_speed_and_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(readings, "SIZES", ((120, 96),))
    words = ["readings", "--at-once", "1", "2", "--repeats", "1", "--out", str(tmp_path)]
    assert main(words) == 0
    document = read_result(tmp_path / "readings.json")
    assert [row["at_once"] for row in document["rows"]] == [1, 2]
    for row in document["rows"]:
        assert 0 < row["off_mm_max"] < 0.01 < 0.3 < row["deepest_mm"]
        assert min(row[name]["images_per_s"] for name in ("heights", "heights and deviation")) > 0
    assert document["headline"]["aim_per_s"] == 20


# Accuracy of presses ------------------------------------------------------------------------------


def test_presses_of_a_sensor_are_compared_with_a_finer_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(press_accuracy, "DEPTHS_MM", (0.1,))
    monkeypatch.setattr(press_accuracy, "NEARER", 2)
    monkeypatch.setattr(press_accuracy, "RELAXING", ())
    coarse = {**PHYSICS, Accuracy.DEFAULT: PHYSICS[Accuracy.FAST]}
    monkeypatch.setattr(press_accuracy, "PHYSICS", coarse)
    words = ["press_accuracy", "--quick", "--families", "flat_pad", "--out", str(tmp_path)]
    assert main([*words, "--tools", "ball 1.5"]) == 0
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
    assert main([*words, "--tools", "hammer"]) == 2
    assert main(["press_accuracy", "--families", "no_such", "--out", str(tmp_path)]) == 2


def test_every_tool_meets_every_material() -> None:
    cases = list(press_accuracy.all_cases())
    for tool in press_accuracy.TOOLS:
        met = {(c.poisson_ratio, c.friction) for c in cases if c.tool == tool}
        if tool in {"ball 1", "ball 0.5"}:  # Small balls are for thick pads.
            assert met == {(ratio, 0.0) for ratio in press_accuracy.PAD_RATIOS}
            continue
        assert met >= set(press_accuracy.MATERIALS)
        assert press_accuracy.PressCase("flat_pad", tool, 0.1, 0.4, 0.0).indenter().contact(0.1)
