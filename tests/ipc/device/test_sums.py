# SPDX-License-Identifier: Apache-2.0
"""Minima over an environment; sums that are the same bits in any order, and how exact they are."""

from __future__ import annotations

import math

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.ipc.device.sums import ReproducibleSums, SumStage, add_vector, lower_to

needs_gpu = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
every_device = pytest.mark.parametrize(
    "device", ["cpu", pytest.param("cuda:0", marks=[pytest.mark.gpu, needs_gpu])]
)


@wp.kernel(enable_backward=False)
def _lower_kernel(values: wp.array2d(dtype=wp.float64), least: wp.array(dtype=wp.float64)):
    env, i = wp.tid()
    lower_to(least, env, values[env, i])


def lowest(values: np.ndarray, device: str) -> np.ndarray:
    least = wp.full(len(values), wp.inf, dtype=wp.float64, device=device)
    given = wp.array(values, dtype=wp.float64, device=device)
    wp.launch(_lower_kernel, dim=values.shape, inputs=[given, least], device=device)
    return least.numpy()


@every_device
@given(st.lists(st.floats(0, 1e300) | st.floats(0, 1e-300), min_size=1, max_size=40))
def test_the_least_of_many_is_found(device: str, values: list[float]) -> None:
    rows = np.array([values, values[::-1]])
    np.testing.assert_array_equal(lowest(rows, device), rows.min(axis=1))


@every_device
def test_what_is_negative_stays_negative_and_what_is_no_number_is_passed_over(device: str) -> None:
    found = lowest(np.array([[3.0, -2.0, -5.0, 1.0], [np.nan, 3.0, np.inf, 0.0]]), device)
    assert found[0] < 0 and found[1] == 0


@wp.kernel(enable_backward=False)
def _add_kernel(
    places: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.vec3d),
    sums: SumStage,
    totals: wp.array2d(dtype=wp.vec3d),
):
    k = wp.tid()
    add_vector(0, places[k], values[k], totals, sums)


def add_up(
    places: np.ndarray, values: np.ndarray, in_any_order: bool = True, runs: int = 1
) -> np.ndarray:
    """Sums of the values [n, 3] of each of three places, added in the order given."""
    sums = ReproducibleSums((1, 3), wp.get_device("cpu"), in_any_order)
    totals = wp.zeros((1, 3), dtype=wp.vec3d, device="cpu")
    where = wp.array(places.astype(np.int32), dtype=wp.int32, device="cpu")
    inputs = [where, wp.array(values, dtype=wp.vec3d, device="cpu")]
    for _ in range(runs):
        totals.zero_()
        for stage in sums.stages():
            wp.launch(_add_kernel, len(values), inputs=[*inputs, stage, totals], device="cpu")
    return totals.numpy()[0]


def addends(seed: int, count: int, decades: float) -> tuple[np.ndarray, np.ndarray]:
    """Of either sign, their sizes spread over so many decades; those of place 2 nearly cancel."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(count, 3)) * 10 ** rng.uniform(-decades, 0, (count, 1))
    places, half = rng.integers(0, 2, count), count // 4
    values[half : 2 * half] = -values[:half] * (1 + 1e-9)
    places[: 2 * half] = 2
    return places, values


@pytest.mark.parametrize("decades", [0, 8, 40])
@pytest.mark.parametrize("count", [1, 2, 12, 3000])
def test_the_order_does_not_matter_and_little_is_lost(count: int, decades: float) -> None:
    places, values = addends(count, count, decades)
    first = add_up(places, values)
    rng = np.random.default_rng(1)
    for _ in range(10):
        order = rng.permutation(count)
        np.testing.assert_array_equal(add_up(places[order], values[order]), first)
    for place in range(3):
        mine = values[places == place]
        if len(mine):
            top = 2.0 ** math.ceil(math.log2(np.abs(mine).max()))
            grid = top * 2 ** math.floor(math.log2(len(mine))) * 2.0**-51
            exact = np.array([math.fsum(column) for column in mine.T])
            assert np.abs(first[place] - exact).max() <= 0.5 * len(mine) * grid
        else:
            assert not first[place].any()


def test_added_as_they_come_the_order_does_matter() -> None:
    places, values = addends(0, 3000, 8)
    order = np.random.default_rng(1).permutation(3000)
    first = add_up(places, values, False)
    assert not np.array_equal(add_up(places[order], values[order], False), first)
    # What was added before is forgotten where it does not.
    np.testing.assert_array_equal(add_up(places, values, runs=3), add_up(places, values))


@pytest.mark.parametrize("scale", [0.0, 5e-324, 1e-310, 1e-290, 1e290])
def test_the_smallest_and_the_largest_numbers_add_up(scale: float) -> None:
    values = scale * np.array([[1.0, -2.0, 4.0], [1.0, 2.0, 4.0]])
    total = add_up(np.zeros(2), values)[0]
    np.testing.assert_allclose(total, values.sum(axis=0), rtol=1e-14, atol=5e-323)


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan])
def test_what_is_not_finite_stays_so_and_in_its_place(bad: float) -> None:
    values = np.array([[1.0, 2.0, 3.0], [bad, 1.0, 1.0], [1.0, 1.0, 1.0]])
    totals = add_up(np.array([0, 0, 1]), values)
    assert not np.isfinite(totals[0, 0])
    np.testing.assert_array_equal(totals[1], [1.0, 1.0, 1.0])
