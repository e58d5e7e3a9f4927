# SPDX-License-Identifier: Apache-2.0
"""Runs of many cases: every family, the processes, Ctrl-C, the result and its table."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.benchmarks.results import read_result
from taccel_lab.benchmarks.stress import suite
from taccel_lab.benchmarks.stress.families import FAMILIES, make_case
from taccel_lab.benchmarks.stress.runner import BudgetOverrun, run_all, run_case, time_limit
from taccel_lab.benchmarks.stress.suite import Stress, case_ids, summarize, table
from taccel_lab.errors import InputError
from tests.benchmarks.stress.rigged import rigged_case
from tests.support.variants import variants
from tools.bench.report.pages import draw_stress

BUDGET_S = 0.4
"""Of a case here: enough for most."""


@pytest.mark.thorough(
    cases=(
        "batch-1",
        "gel_on_gel-1",
        "jump-1",
        "no_way-1",
        "pile-1",
        "soft_on_soft-1",
        "stiff_on_gel-1",
        "throw_and_catch-1",
        "twist-1",
    )
)
@pytest.mark.parametrize(
    ("family", "seed"), variants(((name, 1) for name in FAMILIES), sorted(FAMILIES), [1, 2])
)
def test_no_silent_failure(family: str, seed: int) -> None:
    result = run_case(family, seed, seconds=BUDGET_S)
    wrong = ("silent", "error", "died")
    assert result["outcome"] not in wrong, (result["says"], result["findings"])
    assert result["parameters"]


@pytest.mark.thorough
def test_scenes_are_valid_and_the_same_in_every_run() -> None:
    for family in FAMILIES:
        for seed in range(20, 24):
            case, parameters = make_case(family, seed)
            assert make_case(family, seed)[1] == parameters
            assert case.steps >= 1
            case.scene.finalize()


def test_a_replay_gives_the_same_bits() -> None:
    first, second = (run_case("press", 1) for _ in range(2))
    assert first["outcome"] == "converged"
    for name in ("newton_iterations", "cg_iterations", "smallest_gap_m", "residual_ratio"):
        assert first[name] == second[name]


def work_that_catches_exceptions() -> None:
    while True:
        try:
            sum(range(1000))
        except Exception as error:
            raise RuntimeError("an error of the library's own") from error


def work_that_says_so_in_other_words() -> None:
    try:
        while True:
            pass
    except BaseException:
        raise TypeError("cannot compare") from None


@pytest.mark.parametrize("work", [work_that_catches_exceptions, work_that_says_so_in_other_words])
def test_the_budget_is_kept(work: Callable[[], None]) -> None:
    started = time.process_time()
    with pytest.raises(BudgetOverrun, match=r"0\.05 s of"), time_limit(0.05):
        work()
    assert time.process_time() - started < 1
    with pytest.raises(TypeError, match="wrong"), time_limit(10.0):
        raise TypeError("wrong")


def test_a_case_out_of_time_says_so() -> None:
    assert run_case("pile", 2, seconds=0.05)["outcome"] == "budget"


@pytest.mark.thorough
def test_a_case_that_dies_takes_nothing_along() -> None:
    cases = [("a", seed) for seed in range(4)]
    results = {r["seed"]: r for r in run_all(cases, "cpu", 2, 5.0, rigged_case)}
    assert sorted(results) == [0, 1, 2, 3]
    assert results[1]["outcome"] == "died"
    assert [results[seed]["outcome"] for seed in (0, 2, 3)] == ["converged"] * 3


def test_what_is_finished_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(cases: list, device: str, jobs: int, seconds: float):
        for seed in (0, 1):
            yield run_case("thin_gap", seed, device, seconds)
        raise KeyboardInterrupt

    monkeypatch.setattr(suite, "run_all", interrupted)
    out = tmp_path / "stress.json"
    with pytest.raises(KeyboardInterrupt):
        Stress(count=9, families=("thin_gap",), out=out).run()
    kept = read_result(out)
    assert [case["seed"] for case in kept["cases"]] == [0, 1]
    assert not kept["complete"]
    assert len(draw_stress(kept).axes) == 2
    assert "| thin_gap | 2 |" in table(kept["summary"])


def test_a_case_is_run_again_step_by_step(capsys: pytest.CaptureFixture[str]) -> None:
    Stress(replay="press:1").run()
    said = capsys.readouterr().out
    assert '"dhat"' in said and "step 0: " in said and "converged in" in said
    with pytest.raises(InputError, match=r"FAMILY:SEED.*'nonsense:1'"):
        Stress(replay="nonsense:1").run()


def test_counts_and_table() -> None:
    outcomes = ("converged", "refused", "LINE_SEARCH", "silent", "budget", "died")
    results: list[dict] = [
        {
            "family": "some", "seed": seed, "outcome": outcome, "parameters": {"dt": 0.1},
            "newton_iterations": [3, 5 + seed], "substeps": [1, 2], "processor_seconds": 0.5 * seed,
        }
        for seed, outcome in enumerate(outcomes)
    ]  # fmt: skip
    results[3] |= {"findings": ["gap (environment 0): -1 m | x"], "referees": ["gap"]}
    summary = summarize(results)
    total = summary["total"]
    counts = [total[k] for k in ("converged", "refused", "failed", "silent", "budget", "broken")]
    assert counts == [1] * 6
    assert total["newton_max"] == 10 and total["steps"] == 12 and total["steps_in_parts"] == 6
    assert total["newton_median"] == np.median([3, 5, 3, 6, 3, 7, 3, 8, 3, 9, 3, 10])
    assert [item["case"] for item in summary["failing"]] == ["some:2", "some:3", "some:4", "some:5"]
    assert summary["slowest"][0]["case"] == "some:5"
    text = table(summary)
    assert "1 LINE_SEARCH" in text and "`some:3`" in text and "gap 1" in text
    assert len({line.count("|") for line in text.splitlines()[:4]}) == 1
    # Cases go round the families.
    names = list(FAMILIES)
    ids = case_ids(2 * len(names) + 1, 7)
    assert ids[0] == (names[0], 7) and ids[len(names)] == (names[0], 8)
    assert len(set(ids)) == len(ids)
