# SPDX-License-Identifier: Apache-2.0
"""The radius that holds 95 % of the errors of presses that nobody saw."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.cross_conformal import radius_factor
from taccel_lab.signals.normal_model_config import RAYLEIGH_95


def press_errors(rng: np.random.Generator, pixels: int = 400) -> np.ndarray:
    """Lengths of heavy-tailed vectors, of a size that differs between presses, as real ones do."""
    vectors = rng.standard_t(4, size=(pixels, 2)) / np.sqrt(2)
    return np.exp(rng.normal(0, 0.25)) * np.linalg.norm(vectors, axis=1)


@pytest.mark.parametrize("count", [6, 12, 36])
def test_new_presses_lie_in_the_radius(count: int) -> None:
    rng = np.random.default_rng(count)
    held, normal = [], []
    for _ in range(60):
        factor = radius_factor([press_errors(rng) for _ in range(count)], 0.95, RAYLEIGH_95)
        new = press_errors(rng)
        held.append((new <= factor).mean())
        normal.append((new <= RAYLEIGH_95 * np.sqrt((new**2).mean() / 2)).mean())
    assert np.mean(held) == pytest.approx(0.95, abs=0.02)
    assert np.mean(normal) < 0.945  # even with its own scale known, errors are no normal deviates


def test_normal_deviates_keep_their_radius() -> None:
    rng = np.random.default_rng(0)
    presses = [np.linalg.norm(rng.normal(size=(4000, 2)), axis=1) for _ in range(12)]
    assert radius_factor(presses, 0.95, 1.0) == pytest.approx(RAYLEIGH_95, rel=0.02)


def test_presses_weigh_alike() -> None:
    rng = np.random.default_rng(1)
    presses = [press_errors(rng) for _ in range(8)]
    presses[3] = 3 * presses[3]
    many = [*presses[:3], np.repeat(presses[3], 20), *presses[4:]]
    assert radius_factor(many, 0.95, 1.0) == radius_factor(presses, 0.95, 1.0)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.01, 100.0), st.permutations(range(6)))
def test_it_follows_the_scale_and_not_the_order(scale: float, order: list[int]) -> None:
    rng = np.random.default_rng(2)
    presses = [press_errors(rng, 50) for _ in range(6)]
    found = radius_factor([scale * presses[i] for i in order], 0.95, 1.0)
    assert found == pytest.approx(scale * radius_factor(presses, 0.95, 1.0), rel=1e-9)


def test_too_few_presses_say_nothing() -> None:
    some = [np.ones(5), np.empty(0), np.ones(5), np.ones(5)]
    assert radius_factor(some, 0.95, RAYLEIGH_95) == RAYLEIGH_95
