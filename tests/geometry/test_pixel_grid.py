# SPDX-License-Identifier: Apache-2.0
"""Grids of more and of fewer pixels over the same gel."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.geometry import PixelGrid

GRID = PixelGrid(12, 9, 0.05, 0.07, 5.25, 3.1)


@pytest.mark.parametrize("points", [1, 2, 3])
def test_a_pixel_lies_in_the_middle_of_its_finer_ones(points: int) -> None:
    finer = GRID.refined(points)
    for found, wanted in ((finer.x_mm(), GRID.x_mm()), (finer.y_mm(), GRID.y_mm())):
        middles = found.reshape(-1, points).mean(axis=1)
        np.testing.assert_allclose(middles, wanted, rtol=0, atol=1e-12)
    assert (finer.mm_per_px_x, finer.mm_per_px_y) == (0.05 / points, 0.07 / points)


def test_thinned_pixels_are_those_of_every_third_row_and_column() -> None:
    thin = GRID.thinned(3)
    np.testing.assert_allclose(thin.x_mm(), GRID.x_mm()[::3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(thin.y_mm(), GRID.y_mm()[::3], rtol=0, atol=1e-12)
