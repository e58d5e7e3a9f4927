# SPDX-License-Identifier: Apache-2.0
"""Settings chosen on all sets but one: the left-out one has no say, noise counts."""

from __future__ import annotations

import inspect
from dataclasses import fields

import numpy as np
import pytest

from taccel_lab.benchmarks.color_scene import NETWORK, TABLE, circles, network, table
from taccel_lab.benchmarks.color_settings import SETTINGS
from taccel_lab.benchmarks.left_out import beats_default, choose_left_out
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.registration import RegistrationOptions
from taccel_lab.calibration.color.taxim_table import fit_taxim_table

SETS = ("a", "b", "c")


def scores(means: dict[str, tuple[float, float, float]], scatter: float = 0.0, seeds: int = 2):
    """Figures of 10 presses around means by value and set; presses differ by decibels."""
    rng = np.random.default_rng(0)
    presses = rng.normal(0, 3, 10)
    return {
        value: {
            name: mean + presses + scatter * rng.normal(0, 1, (seeds, 10))
            for name, mean in zip(SETS, by_set, strict=True)
        }
        for value, by_set in means.items()
    }


def test_the_left_out_set_has_no_say() -> None:
    # "high" wins on c alone, and by much.
    found = choose_left_out(scores({"low": (30, 30, 30), "high": (29.5, 29.9, 40)}), "low")
    assert [choice.left_out for choice in found] == list(SETS)
    assert [choice.value for choice in found] == ["high", "high", "low"]
    assert found[0].gain == pytest.approx((-0.1 + 10) / 2)
    assert found[2].gain == 0
    assert not beats_default(found, "low")


def test_a_value_that_wins_everywhere_beats_the_default() -> None:
    clear = choose_left_out(scores({"low": (30, 30, 30), "high": (31, 31, 31)}, 0.2), "low")
    assert {choice.value for choice in clear} == {"high"}
    # A set: 0.2 sqrt(2) a press and seed, averaged once over presses and once over seeds.
    one_set = 0.2 * np.sqrt(2 / 20 + 2 / 20)
    assert clear[0].noise == pytest.approx(one_set / np.sqrt(2), rel=0.6)
    assert beats_default(clear, "low")


def test_a_gain_within_noise_changes_nothing() -> None:
    found = choose_left_out(scores({"low": (30, 30, 30), "high": (30.2, 30.2, 30.2)}, 3.0), "low")
    assert not beats_default(found, "low")


def test_the_default_stays_where_another_is_as_good() -> None:
    same = choose_left_out(scores({"other": (30, 30, 30), "low": (30, 30, 30)}), "low")
    assert {choice.value for choice in same} == {"low"}


def test_seeds_that_disagree_are_noise() -> None:
    given = scores({"low": (30, 30, 30), "high": (31, 31, 31)})
    for figures in given["high"].values():
        figures[0] += 2.0
    found = choose_left_out(given, "low")
    assert found[0].gain == pytest.approx(2.0) and found[0].noise == pytest.approx(0.5**0.5)
    assert beats_default(found, "low")  # 2.0 of 1.41
    for figures in given["high"].values():
        figures[1] -= 2.0
    assert not beats_default(choose_left_out(given, "low"), "low")


def test_one_seed_is_enough() -> None:
    given = scores({"low": (30,) * 3, "high": (31,) * 3}, 0.1, seeds=1)
    found = choose_left_out(given, "low")
    assert all(0 < choice.noise < 0.1 for choice in found) and beats_default(found, "low")
    # Another seed is known to move either mean of either set by 0.6.
    moved = choose_left_out(given, "low", dict.fromkeys(SETS, 0.6))
    assert moved[0].noise == pytest.approx(np.hypot(found[0].noise, 0.6))
    assert not beats_default(moved, "low")


def test_each_default_is_what_the_calibration_has() -> None:
    for setting, (default, values) in SETTINGS.items():
        assert values[default] in (NETWORK, TABLE), setting
        others = [candidate for value, candidate in values.items() if value != default]
        assert all(candidate not in (NETWORK, TABLE) for candidate in others), setting


def test_candidates_name_settings_that_exist() -> None:
    fit = {field.name for field in fields(ColorFitOptions)}
    placing = {field.name for field in fields(RegistrationOptions)}
    of_table = set(inspect.signature(fit_taxim_table).parameters)
    for _, values in SETTINGS.values():
        for candidate in values.values():
            assert set(candidate.fit) <= fit and set(candidate.circles) <= placing
            assert set(candidate.table or {}) <= of_table


def test_candidates_join() -> None:
    joined = network(learning_rate=1e-3).joined(circles(worth=0.5)).joined(network())
    assert joined.fit == {"learning_rate": 1e-3} and joined.circles == {"worth": 0.5}
    assert table(ridge=0.5).joined(table(reach_radii=1.0)).table == {
        "ridge": 0.5, "reach_radii": 1.0,
    }  # fmt: skip
