# SPDX-License-Identifier: Apache-2.0
"""The spread of integrated heights is the one that errors of slopes make."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.height_uncertainty import HeightUncertainty
from taccel_lab.signals.slope_integration import height_from_slopes

GRID = PixelGrid(80, 60, 0.1, 0.1)


def test_the_band_holds_errors_of_its_own_kind() -> None:
    rng = np.random.default_rng(5)
    sigma = np.full((60, 80), 0.01)
    sigma[20:40, 30:50] = 0.1
    spread = HeightUncertainty(GRID, 3.0).sigma_m(sigma)
    scores = []
    for _ in range(60):
        error = gaussian_filter(rng.standard_normal((60, 80, 2)), (3, 3, 0))
        error /= error.std()
        scores.append(height_from_slopes(sigma[..., None] * error, GRID) / spread)
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.2)
    assert spread[30, 40] > 1.3 * spread[5, 5]


def test_it_grows_with_the_slopes_and_with_the_reach_of_errors() -> None:
    sigma = np.full((60, 80), 0.02)
    one, twice = (HeightUncertainty(GRID, 2.0).sigma_m(f * sigma) for f in (1, 2))
    assert twice == pytest.approx(2 * one)
    assert HeightUncertainty(GRID, 6.0).sigma_m(sigma).mean() > 1.5 * one.mean()
    assert (HeightUncertainty(GRID, 2.0).sigma_m(0 * sigma) == 0).all()


def test_errors_along_the_slope_raise_the_whole_floor_and_nothing_beside_it() -> None:
    """Slopes that may be 10 % too steep all around a dent make it so much too deep."""
    y, x = np.mgrid[0:60, 0:80] * 0.1
    dent = -1e-3 * np.exp(-((x - 4) ** 2 + (y - 3) ** 2))
    slope = np.stack(np.gradient(dent, 1e-4)[::-1], axis=-1)
    sigma = 0.1 * np.linalg.norm(slope, axis=-1)
    for length in (2.0, 4.0):
        along = HeightUncertainty(GRID, length).along_m(slope, sigma)
        np.testing.assert_allclose(along, -0.1 * dent, atol=5e-6)
    other = HeightUncertainty(GRID, 2.0).sigma_m(sigma)
    assert other[30, 40] < 0.3 * along[30, 40]


def test_a_coarser_grid_for_far_reaching_errors_gives_the_same_spread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sigma = np.full((60, 80), 0.02)
    sigma[10:30, 10:30] = 0.2
    weights = np.ones((60, 80))
    weights[50:, :20] = 0.0
    coarse = HeightUncertainty(GRID, 8.0).sigma_m(sigma, weights=weights)
    monkeypatch.setattr("taccel_lab.signals.height_uncertainty.POINTS_PER_LENGTH", 8.0)
    fine = HeightUncertainty(GRID, 8.0).sigma_m(sigma, weights=weights)
    assert coarse.mean() == pytest.approx(fine.mean(), rel=0.35)
    assert np.corrcoef(coarse.ravel(), fine.ravel())[0, 1] > 0.5
