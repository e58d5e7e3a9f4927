# SPDX-License-Identifier: Apache-2.0
"""The referee of height maps against planes, analytic bowls and a second interpolation library.

Product and referee are compared in ``test_tactile``.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import LinearNDInterpolator

from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.signals import SurfaceMode
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
    st.sampled_from(SurfaceMode),
)
def test_planes_are_exact_on_any_triangulation(a, b, c, seed, mode):
    mesh = flat_pad(0.4, PAD_HALF_MM, seed)
    signal = HeightMapReferee(mesh, GRID, mode=mode)
    signal.update(shaped(mesh, lambda x, y: a * x + b * y + c))
    x, y = pixel_xy(GRID)
    normal = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    assert np.abs(signal.height_m[0] - (a * x + b * y + c)).max() < 1e-12
    assert np.abs(signal.normals[0] - normal).max() < 1e-8


def test_facet_mode_is_the_piecewise_linear_interpolant():
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=3)
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 1e-4, mesh.node_count)
    positions = shaped(mesh, lambda x, y: noise[: len(x)])
    signal = HeightMapReferee(mesh, GRID, mode=SurfaceMode.FACET)
    signal.update(positions)
    # Delaunay made the mesh, so scipy interpolates on the same triangles.
    top = positions[0, mesh.region_nodes(Region.CONTACT)]
    expected = LinearNDInterpolator(top[:, :2], top[:, 2])(*pixel_xy(GRID))
    assert np.abs(signal.height_m[0] - expected).max() < 1e-13
    assert np.ptp(expected) > 1e-4


@pytest.mark.parametrize(("mode", "ratio"), [(SurfaceMode.SMOOTH, 0.6), (SurfaceMode.FACET, 1.0)])
def test_only_the_smooth_slope_is_continuous(mode, ratio):
    """Halving the pixel halves the largest jump of a continuous slope, and no other."""
    mesh = flat_pad(0.1, (0.5, 0.4), seed=5)
    noise = np.random.default_rng(1).normal(0, 1e-5, mesh.node_count)
    jumps = []
    for pixels in (300, 600):
        grid = PixelGrid(pixels, pixels, 0.3 / pixels, 0.3 / pixels)
        signal = HeightMapReferee(mesh, grid, mode=mode)
        signal.update(shaped(mesh, lambda x, y: noise[: len(x)]))
        jumps.append(np.abs(np.diff(signal.slope[0], axis=1)).max())
    assert jumps[0] > 0.01
    if mode is SurfaceMode.SMOOTH:
        assert jumps[1] < ratio * jumps[0]
    else:
        assert jumps[1] == pytest.approx(jumps[0], rel=0.05)


def _errors(mode: SurfaceMode, element_mm: float) -> tuple[float, float]:
    """RMS height [um] and normal [deg] error of a steep press within 1.6 contact radii."""
    sphere = PressedSphere(1.8e-3)
    mesh = flat_pad(element_mm, (5.2, 4.2))
    grid = PixelGrid(192, 144, 0.05, 0.05)
    signal = HeightMapReferee(mesh, grid, mode=mode)
    signal.update(shaped(mesh, sphere.height))
    x, y = pixel_xy(grid)
    near = sphere.distance_xy(x, y) < 1.6 * 1.8e-3
    height = (signal.height_m[0] - sphere.height(x, y))[near] * 1e6
    normal = angle_deg(signal.normals[0], sphere.normals(x, y))[near]
    return float(np.sqrt((height**2).mean())), float(np.sqrt((normal**2).mean()))


def test_convergence_on_a_steep_press():
    facet = np.array([_errors(SurfaceMode.FACET, h) for h in (0.4, 0.2, 0.1)])
    smooth = np.array([_errors(SurfaceMode.SMOOTH, h) for h in (0.4, 0.2, 0.1)])
    # Measured (0.4, 0.2, 0.1 mm): facet 21, 6.7, 1.8 um and 6.2, 3.4, 1.7 deg; smooth 9.4, 2.9,
    # 0.6 um and 2.7, 1.2, 0.5 deg. Linear theory gives orders 2 and 1.
    facet_order = np.log2(facet[0] / facet[-1]) / 2
    smooth_order = np.log2(smooth[0] / smooth[-1]) / 2
    assert facet_order[0] > 1.6 and facet_order[1] > 0.8
    assert smooth_order[0] > 1.8 and smooth_order[1] > 1.1
    assert (smooth < 0.5 * facet).all()
    assert smooth[1, 0] < 3.5 and smooth[1, 1] < 1.4


def test_slopes_of_pixels_that_are_not_square() -> None:
    grid = PixelGrid(7, 5, 0.04, 0.09)
    height_m = 1e-3 * (0.3 * grid.x_mm()[None, :] - 0.2 * grid.y_mm()[:, None])
    slopes = slopes_from_height(height_m, grid)
    np.testing.assert_allclose(slopes, np.broadcast_to([0.3, -0.2], (5, 7, 2)))
