# SPDX-License-Identifier: Apache-2.0
"""Steps between freezings of friction, on the fixed-point iteration x -> factor x that these are
near a state: a step of length d leaves 1 - d (1 - factor) of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.solvers.friction_lag import next_damping
from tests.ipc.batch import mapped


def sizes(factor: float, freezings: int) -> np.ndarray:
    """Size of x after each freezing, from 1."""
    found, damping = [1.0], 1.0
    for _ in range(freezings):
        left = abs(1.0 - damping * (1.0 - factor))
        found.append(found[-1] * left)
        damping = float(mapped(next_damping, np.array([damping]), np.array([left]))[0])
        assert 0 < damping <= 1
    return np.array(found)


@given(st.floats(-12.0, 0.9))
def test_what_alternates_or_shrinks_settles(factor: float) -> None:
    assert sizes(factor, 80)[-1] < 1e-2


@pytest.mark.parametrize("factor", [1.2, 1.5, 2.0])
def test_what_grows_is_left(factor: float) -> None:
    """With steps that were damped for good, 1.2 took 199."""
    assert np.flatnonzero(sizes(factor, 60) > 10).min() < 35


def test_what_has_stopped_alternating_goes_on_by_steps_that_are_half_as_long_again() -> None:
    """Damped for good, what an eighth of a step leaves takes 100 freezings to a millionth."""
    damping, left, freezings = 0.125, 1.0, 0
    while left > 1e-6:
        left *= 1.0 - damping
        (longer,) = mapped(next_damping, np.array([damping]), np.array([1.0 - damping]))
        assert longer == pytest.approx(min(1.5 * damping, 1.0))
        damping, freezings = float(longer), freezings + 1
    assert freezings <= 7


def test_nothing_left_goes_on_whole() -> None:
    np.testing.assert_array_equal(mapped(next_damping, np.ones(2), np.array([0.0, 0.9])), 1.0)
