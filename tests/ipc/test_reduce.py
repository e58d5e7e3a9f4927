# SPDX-License-Identifier: Apache-2.0
"""Minima over the entries of an environment."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.ipc.reduce import lower_to

DEVICES = [
    "cpu",
    pytest.param(
        "cuda:0",
        marks=[
            pytest.mark.gpu,
            pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device"),
        ],
    ),
]


@wp.kernel(enable_backward=False)
def _lower_kernel(values: wp.array2d(dtype=wp.float64), least: wp.array(dtype=wp.float64)):
    env, i = wp.tid()
    lower_to(least, env, values[env, i])


def lowest(values: np.ndarray, device: str) -> np.ndarray:
    least = wp.full(len(values), wp.inf, dtype=wp.float64, device=device)
    wp.launch(
        _lower_kernel,
        dim=values.shape,
        inputs=[wp.array(values, dtype=wp.float64, device=device), least],
        device=device,
    )
    return least.numpy()


@pytest.mark.parametrize("device", DEVICES)
@given(st.lists(st.floats(0, 1e300) | st.floats(0, 1e-300), min_size=1, max_size=40))
def test_the_least_of_many_is_found(device: str, values: list[float]) -> None:
    rows = np.array([values, values[::-1]])
    np.testing.assert_array_equal(lowest(rows, device), rows.min(axis=1))


@pytest.mark.parametrize("device", DEVICES)
def test_what_is_negative_stays_negative_and_what_is_no_number_is_passed_over(device: str) -> None:
    found = lowest(np.array([[3.0, -2.0, -5.0, 1.0], [np.nan, 3.0, np.inf, 0.0]]), device)
    assert found[0] < 0
    assert found[1] == 0
