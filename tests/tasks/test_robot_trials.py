# SPDX-License-Identifier: Apache-2.0
"""Trials on a robot are planned, recorded one line each, resumed, corrected and summed up."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_image
from taccel_lab.tasks.catalogue import named
from taccel_lab.tasks.robot_trials import (
    TRIALS,
    plan_trials,
    read_trials,
    record_trial,
)
from taccel_lab.tasks.trial_summary import paired_interval, summarise

PEG = named("peg-insertion")
POLICIES = ("touch", "blind")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    plan_trials(PEG, POLICIES, 5, tmp_path / "trials", seed=3)
    return tmp_path / "trials"


def record_all(folder: Path, successes: dict[str, set[int]]) -> None:
    """Record each trial; ``successes``: seeds that each policy masters."""
    while planned := read_trials(folder).next():
        policy = read_trials(folder).policy(planned.number)
        record_trial(folder, "success" if planned.seed in successes[policy] else "failure")


def test_each_policy_gets_each_start_of_the_simulation_in_a_drawn_order(folder: Path) -> None:
    found = read_trials(folder)
    starts, _ = PEG.parameters.start.draw(range(5))  # type: ignore[attr-defined]
    met = [(trial.seed, found.policy(trial.number)) for trial in found.plan.trials]
    assert Counter(met) == Counter((seed, name) for seed in range(5) for name in POLICIES)
    assert all(trial.start == starts[trial.seed] for trial in found.plan.trials)
    # Both trials of a start follow one another; neither policy is always the first.
    assert [a.seed for a in found.plan.trials[::2]] == [b.seed for b in found.plan.trials[1::2]]
    assert {name for _, name in met[::2]} == set(POLICIES)
    for name in POLICIES:
        assert name not in (folder / "plan.json").read_text(), "who judges must not see it"
    orders = []
    for again in ("one", "other"):
        plan_trials(PEG, POLICIES, 200, folder.parent / again)
        orders.append(read_trials(folder.parent / again).key)
    assert orders[0] != orders[1], "without a seed the order is secret"


def test_a_recording_goes_on_after_a_line_that_was_cut_short(folder: Path) -> None:
    record_trial(folder, "success", number=1)
    with open(folder / TRIALS, "a") as file:
        file.write('{"number": 2, "outcome": "fai')
    assert [trial.number for trial in read_trials(folder).trials] == [1]
    record_trial(folder, "failure", note="jammed")
    lines = (folder / TRIALS).read_text().splitlines()
    assert [json.loads(line)["number"] for line in lines] == [1, 2]


def test_void_trials_are_repeated_and_corrections_leave_a_trace(
    folder: Path, tmp_path: Path
) -> None:
    write_image(tmp_path / "photo.png", np.zeros((4, 4, 3), np.uint8))
    record_trial(folder, "void", note="the cable caught", image=tmp_path / "photo.png")
    upcoming = read_trials(folder).next()
    assert upcoming is not None and upcoming.number == 1
    record_trial(folder, "failure")
    record_trial(folder, "success", number=1, note="misread", correct=True)
    found = read_trials(folder)
    assert found.standing()[1].outcome == "success" and len(found.trials) == 3
    assert (folder / found.trials[0].image).read_bytes() == (tmp_path / "photo.png").read_bytes()
    summary = summarise(found, interim=True)
    assert summary.corrected == 1 and sum(rate.voids for rate in summary.rates) == 1


REFUSED = {
    "no start, none or twice the same policy": [
        (lambda f: plan_trials(PEG, POLICIES, 0, f / "new"), "starts must lie in"),
        (lambda f: plan_trials(PEG, (), 5, f / "new"), "number of policies"),
        (lambda f: plan_trials(PEG, ("a", "a"), 5, f / "new"), "different names"),
        (lambda f: plan_trials(PEG, ("a b",), 5, f / "new"), "policies"),
        (lambda f: plan_trials(named("twist"), POLICIES, 5, f / "new"), "no start in x, y"),
        (lambda f: plan_trials(PEG, POLICIES, 5, f), "is there already"),
    ],
    "what is no trial": [
        (lambda f: read_trials(f / "none"), "taccel-lab trials plan"),
        (lambda f: record_trial(f / "none", "success"), "taccel-lab trials plan"),
        (lambda f: record_trial(f, "sucess"), "did you mean success"),
        (lambda f: record_trial(f, "void"), "needs a note"),
        (lambda f: record_trial(f, "success", number=4), "trial 1 is next, not 4"),
        (lambda f: record_trial(f, "success", number=1, correct=True), "a correction needs"),
        (lambda f: record_trial(f, "success", image=f / "none.png"), "does not exist"),
        (lambda f: record_trial(f, "success", note="a\nb"), "note"),
        (lambda f: summarise(read_trials(f)), "no trial is recorded yet"),
    ],
}


@pytest.mark.parametrize("what", REFUSED)
def test_bad_input_is_refused_and_changes_nothing(what: str, folder: Path) -> None:
    before = {path: path.read_bytes() for path in folder.iterdir()}
    for work, words in REFUSED[what]:
        with pytest.raises(InputError, match=words):
            work(folder)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("no json", "line 1, is not valid JSON"),
        ('{"number": 99, "outcome": "success", "time": "2026-01-01T00:00:00Z"}', "has 10 trials"),
        ('{"number": 1, "outcome": "won", "time": "2026-01-01T00:00:00Z"}', "line 1.*outcome"),
    ],
)
def test_a_damaged_line_is_named(folder: Path, line: str, words: str) -> None:
    (folder / TRIALS).write_text(line + "\n")
    with pytest.raises(InputError, match=words):
        read_trials(folder)


def test_the_summary_compares_policies_by_start(folder: Path) -> None:
    record_trial(folder, "failure")
    with pytest.raises(InputError, match="1 of 10 trials are recorded"):
        summarise(read_trials(folder))
    first = read_trials(folder).plan.trials[0]
    winners = {"touch": {0, 1, 2, 3, 4} - {first.seed}, "blind": {0, 1} - {first.seed}}
    record_all(folder, winners)
    with pytest.raises(InputError, match="all 10 trials"):
        record_trial(folder, "success")
    summary = summarise(read_trials(folder))
    assert {r.policy: r.successes for r in summary.rates} == {k: len(v) for k, v in winners.items()}
    (compared,) = summary.comparisons
    assert compared.policies == ("blind", "touch")
    assert (compared.both, compared.only_first) == (len(winners["blind"]), 0)
    assert compared.only_second == len(winners["touch"] - winners["blind"])
    assert compared.p_value == pytest.approx(2 * 0.5**compared.only_second)
    assert json.loads(json.dumps(summary.table()))["planned"] == 10


@pytest.mark.parametrize(
    ("counts", "interval"),
    [
        ((36, 12, 2, 0), (0.0569, 0.3404)),  # Newcombe (1998), method 10
        ((1, 1, 7, 12), (-0.5069, -0.0256)),  # Fagerland et al. (2014), of Bentur et al. (2009)
    ],
)
def test_the_interval_of_a_paired_difference_is_newcombes(
    counts: tuple[int, int, int, int], interval: tuple[float, float]
) -> None:
    assert paired_interval(*counts) == pytest.approx(interval, abs=5e-5)
    turned = paired_interval(counts[0], counts[2], counts[1], counts[3])
    assert turned == pytest.approx((-interval[1], -interval[0]), abs=5e-5)
