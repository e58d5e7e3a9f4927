# SPDX-License-Identifier: Apache-2.0
"""Heights from slopes against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.slope_integration import height_from_slopes, solve_poisson

OBLONG = PixelGrid(53, 41, 0.05, 0.08)


def plane_of(grid: PixelGrid) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(grid.x_mm() * 1e-3, grid.y_mm() * 1e-3)
    return x, y


@given(
    width=st.integers(2, 40), height=st.integers(2, 40), seed=st.integers(0, 99),
    ratio=st.floats(0.3, 3.0),
)  # fmt: skip
def test_second_degree_is_exact_on_oblong_pixels(
    width: int, height: int, seed: int, ratio: float
) -> None:
    grid = PixelGrid(width, height, 0.05, 0.05 * ratio)
    a, b, c, d, e = np.random.default_rng(seed).normal(0, [1, 1, 300, 300, 300])
    x, y = plane_of(grid)
    truth = a * x + b * y + c * x**2 + d * y**2 + e * x * y
    slope = np.stack([a + 2 * c * x + e * y, b + 2 * d * y + e * x], axis=-1)
    found = height_from_slopes(slope, grid, zero=np.ones(x.shape, dtype=bool))
    assert found == pytest.approx(truth - truth.mean(), abs=1e-12 * (1 + np.ptp(truth)))


def test_smooth_dent_converges_with_second_order() -> None:
    errors = []
    for scale in (0.1, 0.05):
        n = round(6.0 / scale) + 1
        grid = PixelGrid(n, n, scale, scale)
        x, y = plane_of(grid)
        width = 1e-3
        truth = -1e-3 * np.exp(-(x**2 + y**2) / width**2)
        slope = np.stack([-2 * x / width**2 * truth, -2 * y / width**2 * truth], axis=-1)
        errors.append(np.abs(height_from_slopes(slope, grid) - truth).max())
    assert errors[0] < 1e-5
    assert errors[1] < errors[0] / 3.5


def test_poisson_solution_satisfies_the_equation() -> None:
    rng = np.random.default_rng(1)
    right = rng.normal(size=(17, 23))
    right -= right.mean()
    h = solve_poisson(right, (0.5, 2.0))
    padded = np.pad(h, 1, mode="edge")
    laplacian = (padded[1:-1, 2:] - 2 * h + padded[1:-1, :-2]) / 0.25
    laplacian += (padded[2:, 1:-1] - 2 * h + padded[:-2, 1:-1]) / 4.0
    assert laplacian == pytest.approx(right, abs=1e-10)


@pytest.mark.parametrize("poison", [np.nan, np.inf, 1e6])
def test_poisoned_masked_slopes_have_no_effect(poison: float) -> None:
    x, y = plane_of(OBLONG)
    truth = 40 * x**2 - 60 * y**2
    slope = np.stack([80 * x, -120 * y], axis=-1)
    weights = np.ones(x.shape)
    weights[10:20, 25:40] = 0.0
    clean = height_from_slopes(slope, OBLONG, weights=weights)
    dirty = slope.copy()
    dirty[weights == 0] = poison
    assert np.array_equal(height_from_slopes(dirty, OBLONG, weights=weights), clean)
    border = np.ones(x.shape, dtype=bool)
    border[1:-1, 1:-1] = False
    seen = weights > 0
    # The bridge over the hole weighs a millionth, and pulls by as much.
    assert clean[seen] == pytest.approx((truth - truth[border].mean())[seen], abs=1e-4 * 3e-4)


def test_zero_is_where_it_is_asked_for() -> None:
    x, _ = plane_of(OBLONG)
    slope = np.stack([np.full(x.shape, 0.5), np.zeros(x.shape)], axis=-1)
    zero = np.zeros(x.shape, dtype=bool)
    zero[:, 0] = True
    found = height_from_slopes(slope, OBLONG, zero=zero)
    assert found[:, 0] == pytest.approx(0.0, abs=1e-15)
    assert found[0, -1] == pytest.approx(0.5 * 52 * 0.05e-3)


def test_bad_input_is_refused() -> None:
    slope = np.zeros((41, 53, 2))
    with pytest.raises(InputError, match="the pixel grid asks for"):
        height_from_slopes(np.zeros((40, 53, 2)), OBLONG)
    with pytest.raises(InputError, match="weight 0"):
        height_from_slopes(np.full((41, 53, 2), np.nan), OBLONG)
    with pytest.raises(InputError, match=r"0\.\.1"):
        height_from_slopes(slope, OBLONG, weights=np.full((41, 53), 2.0))
    with pytest.raises(InputError, match="every weight is 0"):
        height_from_slopes(slope, OBLONG, weights=np.zeros((41, 53)))
    with pytest.raises(InputError, match="0 pixels"):
        height_from_slopes(slope, OBLONG, zero=np.zeros((41, 53), dtype=bool))
