# SPDX-License-Identifier: Apache-2.0
"""Polynomials through values and slopes are exact where they can be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import polynomial

from taccel_lab.calibration.material.interpolation import (
    chebyshev_basis,
    chebyshev_nodes,
    fit_surface,
)


def evaluated(coefficients: np.ndarray, x: float, y: float) -> np.ndarray:
    at_x = chebyshev_basis(x, coefficients.shape[0])[0]
    at_y = chebyshev_basis(y, coefficients.shape[1])[0]
    return np.einsum("j,i,jik->k", at_x, at_y, coefficients)


@given(
    st.integers(1, 3),
    st.integers(1, 4),
    st.booleans(),
    st.booleans(),
    st.integers(0, 2**31),
)
def test_polynomials_of_the_space_come_back(
    m: int, n: int, by_first: bool, by_second: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = (2 if by_first else 1) * m, (2 if by_second else 1) * n
    true = rng.standard_normal((rows, columns, 2))
    true[m:, n:] = 0  # P_m x P_2n + P_2m x P_n
    x, y = (2 * chebyshev_nodes(count) - 1 for count in (m, n))

    def grid(c: np.ndarray) -> np.ndarray:
        return np.moveaxis(polynomial.polygrid2d(x, y, c), 0, -1)

    found = fit_surface(
        x,
        y,
        grid(true),
        grid(polynomial.polyder(true, axis=0)) if by_first else None,
        grid(polynomial.polyder(true, axis=1)) if by_second else None,
    )
    assert found.shape == true.shape
    for at_x, at_y in rng.uniform(-1, 1, (4, 2)):
        expected = polynomial.polyval2d(at_x, at_y, true)
        np.testing.assert_allclose(evaluated(found, at_x, at_y), expected, atol=1e-8)


def test_three_nodes_with_slopes_are_better_than_five_values() -> None:
    def miss(count: int, sloped: bool) -> float:
        nodes = 2 * chebyshev_nodes(count) - 1
        values = np.exp(1.5 * nodes)[None, :, None]
        c = fit_surface(np.zeros(1), nodes, values, None, 1.5 * values if sloped else None)
        at = np.linspace(-1, 1, 101)
        return max(abs(evaluated(c, 0.0, y)[0] - np.exp(1.5 * y)) for y in at)

    # The node polynomial is (T_3 / 4)^2 instead of T_6 / 32.
    assert miss(6, False) < miss(3, True) < 2.2 * miss(6, False)
    assert miss(3, True) < 0.5 * miss(5, False)
    slope = chebyshev_basis(0.3, 6)[1]
    shifted = (chebyshev_basis(0.3 + 1e-6, 6)[0] - chebyshev_basis(0.3 - 1e-6, 6)[0]) / 2e-6
    assert slope == pytest.approx(shifted, abs=1e-8)
