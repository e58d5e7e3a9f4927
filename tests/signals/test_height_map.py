# SPDX-License-Identifier: Apache-2.0
"""The referee of height maps against planes and analytic bowls.

Product and referee are compared in ``test_tactile``.
"""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.normals import slopes_from_height
from tests.signals.height_map_referee import HeightMapReferee
from tests.signals.pressed_surface import PressedSphere, angle_deg, flat_pad, pixel_xy, shaped

GRID = PixelGrid(96, 72, 0.05, 0.05)
PAD_HALF_MM = (3.0, 2.4)


@settings(max_examples=25)
@given(
    st.floats(-2, 2),
    st.floats(-2, 2),
    st.floats(-1e-3, 1e-3),
    st.integers(0, 10_000),
)
def test_planes_are_exact_on_any_triangulation(a, b, c, seed):
    mesh = flat_pad(0.4, PAD_HALF_MM, seed)
    signal = HeightMapReferee(mesh, GRID)
    signal.update(shaped(mesh, lambda x, y: a * x + b * y + c))
    x, y = pixel_xy(GRID)
    normal = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    assert np.abs(signal.height_m[0] - (a * x + b * y + c)).max() < 1e-12
    assert np.abs(signal.normals[0] - normal).max() < 1e-8


def test_the_slope_is_continuous():
    """Halving the pixel halves the largest jump of a continuous slope, and of no other."""
    mesh = flat_pad(0.1, (0.5, 0.4), seed=5)
    noise = np.random.default_rng(1).normal(0, 1e-5, mesh.node_count)
    jumps = []
    for pixels in (300, 600):
        grid = PixelGrid(pixels, pixels, 0.3 / pixels, 0.3 / pixels)
        signal = HeightMapReferee(mesh, grid)
        signal.update(shaped(mesh, lambda x, y: noise[: len(x)]))
        jumps.append(np.abs(np.diff(signal.slope[0], axis=1)).max())
    assert jumps[0] > 0.01 and jumps[1] < 0.6 * jumps[0]


def _errors(element_mm: float) -> tuple[float, float]:
    """RMS height [um] and normal [deg] error of a steep press within 1.6 contact radii."""
    sphere = PressedSphere(1.8e-3)
    mesh = flat_pad(element_mm, (5.2, 4.2))
    grid = PixelGrid(192, 144, 0.05, 0.05)
    signal = HeightMapReferee(mesh, grid)
    signal.update(shaped(mesh, sphere.height))
    x, y = pixel_xy(grid)
    near = sphere.distance_xy(x, y) < 1.6 * 1.8e-3
    height = (signal.height_m[0] - sphere.height(x, y))[near] * 1e6
    normal = angle_deg(signal.normals[0], sphere.normals(x, y))[near]
    return float(np.sqrt((height**2).mean())), float(np.sqrt((normal**2).mean()))


def test_convergence_on_a_steep_press():
    found = np.array([_errors(h) for h in (0.4, 0.2, 0.1)])
    # Measured (0.4, 0.2, 0.1 mm): 9.4, 2.9, 0.6 um and 2.7, 1.2, 0.5 deg; facets would give 21,
    # 6.7, 1.8 um and 6.2, 3.4, 1.7 deg, of orders 2 and 1.
    order = np.log2(found[0] / found[-1]) / 2
    assert order[0] > 1.8 and order[1] > 1.1
    assert (found < 0.5 * np.array([[21, 6.2], [6.7, 3.4], [1.8, 1.7]])).all()
    assert found[1, 0] < 3.5 and found[1, 1] < 1.4


def test_slopes_of_pixels_that_are_not_square() -> None:
    grid = PixelGrid(7, 5, 0.04, 0.09)
    height_m = 1e-3 * (0.3 * grid.x_mm()[None, :] - 0.2 * grid.y_mm()[:, None])
    slopes = slopes_from_height(height_m, grid)
    np.testing.assert_allclose(slopes, np.broadcast_to([0.3, -0.2], (5, 7, 2)))
