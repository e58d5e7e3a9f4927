# SPDX-License-Identifier: Apache-2.0
"""The benchmark of several GPUs, with the CPU in their place."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.benchmarks.command_line import main, parse
from taccel_lab.benchmarks.results import read_result
from taccel_lab.errors import InputError


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
    assert len(capsys.readouterr().err.splitlines()) == 2 + len(rows)


def test_wrong_options_are_refused(tmp_path: Path) -> None:
    out = ("--out", str(tmp_path / "found.json"))
    with pytest.raises(InputError, match="device 'cuda:77' is not here; devices are cpu"):
        parse(["multi_gpu", "--devices", "cuda:77", *out]).run()
    with pytest.raises(InputError, match="must be at least 1"):
        parse(["multi_gpu", "--devices", "cpu", "--envs", "0", *out]).run()
    assert not list(tmp_path.iterdir())
