# SPDX-License-Identifier: Apache-2.0
"""Surfaces of height maps, and the PLY files that other programs read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.height_surface import points_of_heights, triangles_of_pixels, write_ply
from taccel_lab.signals.normals import normals_from_height

GRID = PixelGrid(8, 6, 0.2, 0.1)


def test_a_surface_is_read_by_another_program_as_it_is(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    height_m = 1e-5 * rng.standard_normal((6, 8))
    height_m[2, 3] = np.nan
    points_m, normals = points_of_heights(height_m, GRID), normals_from_height(height_m, GRID)
    write_ply(tmp_path / "a.ply", points_m, normals)
    read = pyvista.read(tmp_path / "a.ply")
    known = np.isfinite(height_m)
    np.testing.assert_allclose(read.points, points_m[known], atol=1e-9)
    np.testing.assert_allclose(read.point_data["Normals"], normals[known], atol=1e-6)
    # One of the pixels inside is missing: the six triangles around it are.
    assert read.n_cells == 2 * 7 * 5 - 6
    (x, y, _), area_mm2 = np.ptp(points_m[known], axis=0), 1e6 * read.area
    assert (x, y) == pytest.approx((7 * 0.2e-3, 5 * 0.1e-3))
    assert area_mm2 == pytest.approx((70 - 6) * 0.5 * 0.2 * 0.1, rel=0.05)


def test_triangles_turn_around_the_outward_normal() -> None:
    points = points_of_heights(np.zeros((6, 8)), GRID).reshape(-1, 3)
    a, b, c = points[triangles_of_pixels(np.ones((6, 8), dtype=bool))].swapaxes(0, 1)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_a_map_of_another_size_is_refused() -> None:
    with pytest.raises(InputError, match=r"heights must have shape \[6, 8\], got \[8, 6\]"):
        points_of_heights(np.zeros((8, 6)), GRID)
