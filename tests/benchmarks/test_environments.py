# SPDX-License-Identifier: Apache-2.0
"""The suite ``environments``: what its rows say."""

from __future__ import annotations

from pathlib import Path

import pytest

from taccel_lab.benchmarks import environments
from taccel_lab.benchmarks.command_line import main
from taccel_lab.benchmarks.results import read_result


def test_rows_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = "--envs 1 3 --steps 3 --warm-up 4 --repeats 2 --randomised --out"
    assert main(["environments", *few.split(), str(tmp_path)]) == 0
    document = read_result(tmp_path / "environments.json")
    assert document["complete"] and document["settings"]["size_px"] == [80, 60]
    assert [row["envs"] for row in document["rows"]] == [1, 3]
    for row in document["rows"]:
        assert row["fps"]["count"] == 2 and row["failed"] == 0
        assert row["env_steps"] == 2 * 3 * row["envs"]
        assert row["fps"]["median"] == pytest.approx(
            1e3 * row["envs"] / row["ms_per_step"]["median"], rel=0.2
        )
        parts = row["parts_ms_per_step"]
        assert {"step", "rgb", "markers_px", "wrench", "other"} <= set(parts)
        assert all(ms > 0 for ms in parts.values())
        assert row["residual"]["unconverged"] == 0 and row["gels"] == 2
        assert row["residual"]["worst_over_allowed"] <= 1
    assert "in parts [ms]: " in capsys.readouterr().err


def test_parts_leave_the_environment_as_it_was() -> None:
    """Nothing is timed afterwards, and episodes that begin are counted."""
    options = environments.Environments(size_px=(40, 30), warm_up=2)
    loop = environments.EnvironmentLoop(2, options)
    loop.env.task.step_limit = 3
    parts, motion, begun = loop.run_in_parts(8)
    assert begun == 4 and motion.env_steps == 2 * 8 - 4 and parts["reset"] > 0
    assert "step" not in vars(loop.env.solver) and "read" not in vars(loop.env.views)
    assert loop.run(2) > 0
    assert motion.env_steps == 12


def test_wrong_options_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for words, message in (
        ("--envs 0", "must be at least 1"),
        ("--size-px 80", "width and height, got 1"),
        ("--task juggle", "'juggle' is no task that can be learned"),
    ):
        assert main(["environments", *words.split(), "--out", str(tmp_path)]) == 2
        assert message in capsys.readouterr().err
