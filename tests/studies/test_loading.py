# SPDX-License-Identifier: Apache-2.0
"""Loadings among what force testers record: cycles, travel through air, drift of the load cell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.studies.loading import find_touch, first_loading

DOWN = np.linspace(0.0, 0.4, 41)
UP = DOWN[::-1]


def test_cycles_leave_the_first_way_down() -> None:
    keep, remark = first_loading(np.concatenate([DOWN, UP, DOWN, UP]))
    assert keep.tolist() == list(range(41))
    assert remark == "123 rows of ways back and later cycles left out"


def test_of_growing_cycles_what_goes_deeper_is_kept() -> None:
    depth = np.concatenate([0.3 * DOWN, 0.3 * UP, 0.6 * DOWN, 0.6 * UP, DOWN])
    keep, _ = first_loading(depth)
    assert depth[keep].max() == 0.4
    assert set(keep.tolist()) >= set(range(41))
    # Of the later ways down no row that was passed before, but for noise.
    assert depth[keep[keep > 81]].min() > 0.3 * 0.4 - 0.05 * 0.4 - 1e-9


def test_rows_without_an_order_are_sorted() -> None:
    keep, remark = first_loading(np.random.default_rng(0).permutation(DOWN))
    assert len(keep) == 41 and "sorted" in remark
    keep, remark = first_loading(UP)
    assert keep.tolist() == list(range(40, -1, -1)) and "sorted" in remark
    assert first_loading(DOWN) == (pytest.approx(np.arange(41)), "")


@settings(max_examples=40, deadline=None)
@given(
    air=st.floats(0.15, 8.0), power=st.floats(1.0, 2.5), seed=st.integers(0, 99),
    zero=st.floats(-5.0, 5.0), drift=st.floats(-0.1, 0.1),
)  # fmt: skip
def test_the_touch_and_the_load_cell_s_zero_are_found(
    air: float, power: float, seed: int, zero: float, drift: float
) -> None:
    """Of 300 rows, with noise of 2 % and of 0.3 % of the largest force."""
    rng = np.random.default_rng(seed)
    depth = np.linspace(1.0, 1.4 + air, 300)
    touch = 1.0 + air
    pressed = np.clip((depth - touch) / 0.4, 0.0, None) ** power
    noisy = pressed * (1 + 0.02 * rng.normal(size=300)) + 0.003 * rng.normal(size=300)
    found = find_touch(depth, noisy + zero + drift * (depth - touch) / (0.4 + air))
    assert found is not None
    assert found.depth_mm == pytest.approx(touch, abs=0.03)
    # In contact the drift stands still in what was put in as well as in what is taken off.
    assert found.force_n == pytest.approx(zero, abs=0.02)


@settings(max_examples=40, deadline=None)
@given(power=st.floats(1.0, 2.5), rows=st.integers(5, 300), seed=st.integers(0, 99))
def test_a_record_that_begins_at_the_touch_is_left_alone(
    power: float, rows: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    depth = np.linspace(0.0, 0.4, rows)
    force = depth**power * (1 + 0.02 * rng.normal(size=rows))
    found = find_touch(depth, force)
    assert found is None or (found.depth_mm < 0.1 and abs(found.force_n) < 0.03 * force.max())
