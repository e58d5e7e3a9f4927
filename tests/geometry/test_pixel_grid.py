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


def test_a_block_lies_in_the_middle_of_its_pixels() -> None:
    thin = GRID.thinned(3)
    for found, pixels in ((thin.x_mm(), GRID.x_mm()), (thin.y_mm(), GRID.y_mm())):
        whole = len(pixels) // 3
        middles = pixels[: 3 * whole].reshape(-1, 3).mean(axis=1)
        np.testing.assert_allclose(found[:whole], middles, rtol=0, atol=1e-12)
    coarse = PixelGrid(320, 240, 0.2, 0.2).thinned(8)
    assert coarse.mm_per_px_x == pytest.approx(1.6)
