# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab task list``, ``run`` and ``record``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.tasks.catalogue import FILES, names
from taccel_lab.tasks.peg_insertion import PegInsertion
from taccel_lab.tasks.replay import read_replay
from tests.cli.conftest import Cli

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")


def short_task(folder: Path, steps: int) -> Path:
    """The peg insertion, ended after a few steps."""
    text = (FILES / "peg-insertion.toml").read_text(encoding="utf-8")
    path = folder / "short.toml"
    path.write_text(text.replace("steps = 60", f"steps = {steps}"), encoding="utf-8")
    return path


def test_list(cli: Cli) -> None:
    text = cli("task list").out
    assert all(name in text for name in names())
    listed = cli.json("task list")
    assert list(listed) == names()
    assert all(task["published"][0]["differs"] for task in listed.values())


@pytest.mark.thorough
def test_run(cli: Cli, tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = ["task run", short_task(tmp_path, 3), "--seeds", "2", "--out", out]
    said = cli(*words).err
    assert "short: 0 of 2 seeds, 0.0% (95 %: 0.0% to 65.8%, Wilson)" in said
    assert [path.name for path in out.iterdir() if path.suffix in (".json", ".html")] == [
        name for name in ("result.json", "report.html") if name in said
    ]
    result = json.loads((out / "result.json").read_text())
    assert (result["trials"], result["success_rate"]) == (2, 0.0)
    assert [row["seed"] for row in result["per_seed"]] == [0, 1]
    assert result["settings"]["steps"] == 3 and result["run"]["device"] == "CPU, one thread"
    assert result["settings"]["environments"] == 8
    # One environment at a time starts each seed the same way.
    cli(*words[:-1], tmp_path / "alone", "--environments", "1")
    single = json.loads((tmp_path / "alone" / "result.json").read_text())
    assert single["settings"]["environments"] == 1
    for one, both in zip(single["per_seed"], result["per_seed"], strict=True):
        assert (one["x_mm"], one["y_mm"]) == (both["x_mm"], both["y_mm"])
    # A folder of somebody's own is not replaced.
    (out / "mine.txt").write_text("mine")
    assert "mine.txt" in cli.refusal(*words)


def test_interrupted_run_keeps_what_is_done(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure = PegInsertion.measure

    def interrupted(self: PegInsertion) -> None:
        if 1 in self.seeds:
            raise KeyboardInterrupt
        measure(self)

    monkeypatch.setattr(PegInsertion, "measure", interrupted)
    path, out = short_task(tmp_path, 2), tmp_path / "run"
    path.write_text(path.read_text().replace("environments = 8", "environments = 1"))
    told = cli("task run", path, "--seeds", "3", "--out", out, code=130).err
    assert "interrupted; 1 of 3 seeds are kept" in told
    assert [row["seed"] for row in json.loads((out / "result.json").read_text())["per_seed"]] == [0]


@pytest.mark.thorough
def test_record(cli: Cli, tmp_path: Path) -> None:
    out = tmp_path / "recorded"
    words = [short_task(tmp_path, 6), "--seed", "2", "--out", out]
    assert "seed 2: came " in cli("task record", *words).err
    assert json.loads((out / "trial.json").read_text())["seed"] == 2
    replay = read_replay(out)
    assert len(replay.times_s) == 4 and replay.rgb.max() > 0
    moved = [np.ptp(body.vertices_m, axis=0).max() for body in replay.bodies]
    assert max(moved) > 1e-4
