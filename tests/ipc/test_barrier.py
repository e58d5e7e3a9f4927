# SPDX-License-Identifier: Apache-2.0
"""Barrier against golden values, ipctk and finite differences."""

from __future__ import annotations

import ipctk
import numpy as np
import pytest

from tests.ipc import batch

# d/dhat = 0.1, 0.5, 0.9 at dhat = 1e-3: value and first derivative.
GOLDEN = [
    (0.1, 1.8650939253251768e-06, -1.224465316738928e-2),
    (0.5, 1.732867951399863e-07, -1.1931471805599453e-3),
    (0.9, 1.0536051565782615e-09, -3.218321424267632e-5),
]


@pytest.mark.parametrize(("ratio", "value", "slope"), GOLDEN)
def test_golden_values(ratio: float, value: float, slope: float) -> None:
    ipc_form, _ = batch.barrier(np.array([ratio * 1e-3]), 1e-3)
    # At 0.9 the argument 1 - d/dhat = 0.1 is itself rounded to 1e-16 / 0.1.
    assert ipc_form[0, 0] == pytest.approx(value, rel=1e-14, abs=0)
    assert ipc_form[0, 1] == pytest.approx(slope, rel=1e-14, abs=0)


def test_equals_ipctk() -> None:
    rng = np.random.default_rng(0)
    dhat = 10.0 ** rng.uniform(-6, 0, 2000)
    d = dhat * 10.0 ** rng.uniform(-8, 0.2, 2000)
    ipc_form, _ = batch.barrier(d, dhat)
    pairs = list(zip(d, dhat, strict=True))
    functions = (ipctk.barrier, ipctk.barrier_first_derivative, ipctk.barrier_second_derivative)
    active = d < dhat
    assert 0 < active.sum() < len(d)
    assert np.all(ipc_form[~active] == 0.0)
    for column, function in enumerate(functions):
        expected = np.array([function(*pair) for pair in pairs])
        scale = dhat ** (2 - column)
        np.testing.assert_allclose(ipc_form[:, column] / scale, expected / scale, rtol=1e-11,
                                   atol=1e-14)  # fmt: skip


def test_contact_potential_is_the_scaled_barrier() -> None:
    dhat, stiffness = 2e-4, 3.7
    d = dhat * np.linspace(0.01, 1.1, 50)
    ipc_form, potential = batch.barrier(d, dhat, stiffness)
    np.testing.assert_allclose(potential, ipc_form * stiffness / dhat, rtol=1e-13)
    # Pressure depends on d / dhat alone: force at half the distance of half the dhat is equal.
    _, halved = batch.barrier(d / 2, dhat / 2, stiffness)
    np.testing.assert_allclose(halved[:, 1], potential[:, 1], rtol=1e-13)
    assert np.all(potential[d < dhat, 1] < 0.0)


def test_derivatives_equal_finite_differences() -> None:
    dhat = 1e-3
    d = dhat * np.linspace(0.02, 0.98, 97)
    step = 1e-6 * d
    _, here = batch.barrier(d, dhat)
    _, above = batch.barrier(d + step, dhat)
    _, below = batch.barrier(d - step, dhat)
    for order in (1, 2):
        slope = (above[:, order - 1] - below[:, order - 1]) / (2 * step)
        np.testing.assert_allclose(here[:, order], slope, rtol=1e-6)
    assert np.all(here[:, 2] > 0.0)
