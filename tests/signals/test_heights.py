# SPDX-License-Identifier: Apache-2.0
"""Heights of pixels: from slopes with their spread, and from a grey drop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.deviations import HeightUncertainty
from taccel_lab.reading.slope_integration import height_from_slopes, resting_height
from taccel_lab.signals.depth_response import LUMA, DepthResponse, channel_of
from taccel_lab.signals.normals import slopes_from_height
from tests.signals.pressed_surface import pixel_xy

OBLONG = PixelGrid(53, 41, 0.05, 0.08)


@given(
    width=st.integers(2, 40), height=st.integers(2, 40), seed=st.integers(0, 99),
    ratio=st.floats(0.3, 3.0),
)  # fmt: skip
def test_second_degree_is_exact_on_oblong_pixels(width, height, seed, ratio):
    grid = PixelGrid(width, height, 0.05, 0.05 * ratio)
    a, b, c, d, e = np.random.default_rng(seed).normal(0, [1, 1, 300, 300, 300])
    x, y = pixel_xy(grid)
    truth = a * x + b * y + c * x**2 + d * y**2 + e * x * y
    slope = np.stack([a + 2 * c * x + e * y, b + 2 * d * y + e * x], axis=-1)
    found = height_from_slopes(slope, grid, zero=np.ones(x.shape, dtype=bool))
    assert found == pytest.approx(truth - truth.mean(), abs=1e-12 * (1 + np.ptp(truth)))
    # Central differences are exact as well.
    inside = (slice(1, -1), slice(1, -1))
    back = slopes_from_height(truth, grid)[inside]
    np.testing.assert_allclose(back, slope[inside], rtol=1e-9, atol=1e-9)


def test_smooth_dent_converges_with_second_order():
    errors = []
    for scale, count in ((0.1, 61), (0.05, 121)):
        grid = PixelGrid(count, count, scale, scale)
        x, y = pixel_xy(grid)
        truth = -1e-3 * np.exp(-(x**2 + y**2) / 1e-6)
        slope = np.stack([-2 * x / 1e-6 * truth, -2 * y / 1e-6 * truth], axis=-1)
        errors.append(np.abs(height_from_slopes(slope, grid) - truth).max())
    assert errors[0] < 1e-5 and errors[1] < errors[0] / 3.5


@pytest.mark.parametrize("poison", [np.nan, np.inf, 1e6])
def test_poisoned_masked_slopes_have_no_effect(poison):
    x, y = pixel_xy(OBLONG)
    truth = 40 * x**2 - 60 * y**2
    slope = np.stack([80 * x, -120 * y], axis=-1)
    weights = np.ones(x.shape)
    weights[10:20, 25:40] = 0.0
    clean = height_from_slopes(slope, OBLONG, weights=weights)
    dirty = np.where(weights[..., None] == 0, poison, slope)
    assert np.array_equal(height_from_slopes(dirty, OBLONG, weights=weights), clean)
    border = np.ones(x.shape, dtype=bool)
    border[1:-1, 1:-1] = False
    seen = weights > 0
    # The bridge over the hole weighs a millionth, and pulls by as much.
    assert clean[seen] == pytest.approx((truth - truth[border].mean())[seen], abs=1e-4 * 3e-4)


def test_zero_is_where_it_is_asked_for():
    slope = np.tile([0.5, 0.0], (41, 53, 1))
    zero = np.zeros((41, 53), dtype=bool)
    zero[:, 0] = True
    found = height_from_slopes(slope, OBLONG, zero=zero)
    assert found[:, 0] == pytest.approx(0.0, abs=1e-15)
    assert found[0, -1] == pytest.approx(0.5 * 52 * 0.05e-3)


def test_a_tilt_that_an_odd_corner_at_rest_shows_is_taken_off():
    """The plane of least squares, drawn to level by a spread of 0.1 half sides, of pixels in an L:
    across and down go together there."""
    x, y = pixel_xy(OBLONG)
    corner = 1e3 * (x - y) > 1.2
    surface = 0.3 * x - 0.2 * y + np.where(corner, 0.0, -1e-4 * np.cos(2e3 * x * y / 1e-3))
    slope = slopes_from_height(surface, OBLONG)
    level = height_from_slopes(slope, OBLONG, zero=corner)
    v, u = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 53), indexing="ij")
    terms = np.stack([np.ones(x.shape), u - u[corner].mean(), v - v[corner].mean()], axis=-1)
    count = corner.sum()
    drawn = 0.1 * np.sqrt(count) * np.eye(3)[1:]
    rows = np.concatenate([terms[corner], drawn])
    plane = np.linalg.lstsq(rows, np.concatenate([level[corner], [0.0, 0.0]]), rcond=None)[0]
    assert np.mean(terms[corner][:, 1] * terms[corner][:, 2]) > 0.03
    found = resting_height(slope, OBLONG, zero=corner)
    np.testing.assert_allclose(found, level - terms @ plane, atol=1e-9)


@pytest.mark.parametrize(
    ("slope", "options", "words"),
    [
        (np.zeros((40, 53, 2)), {}, "the pixel grid asks for"),
        (np.full((41, 53, 2), np.nan), {}, "weight 0"),
        (np.zeros((41, 53, 2)), {"weights": np.full((41, 53), 2.0)}, r"0\.\.1"),
        (np.zeros((41, 53, 2)), {"weights": np.zeros((41, 53))}, "every weight is 0"),
        (np.zeros((41, 53, 2)), {"zero": np.zeros((41, 53), dtype=bool)}, "no pixel"),
    ],
)
def test_bad_slopes_are_refused(slope, options, words):
    with pytest.raises(InputError, match=words):
        height_from_slopes(slope, OBLONG, **options)


GRID = PixelGrid(80, 75, 0.1, 0.08)
ROWS, COLUMNS = np.mgrid[0:75, 0:80] * np.array([0.08, 0.1])[:, None, None]
DENT = -1e-3 * np.exp(-((COLUMNS - 4) ** 2 + (ROWS - 3) ** 2))
SLOPE = np.stack(np.gradient(DENT, 8e-5, 1e-4)[::-1], axis=-1)


def test_the_band_holds_errors_of_its_own_kind():
    rng = np.random.default_rng(5)
    sigma = np.full((75, 80), 0.01)
    sigma[20:40, 30:50] = 0.1
    spread = HeightUncertainty(GRID, 3.0).sigma_m(sigma)
    scores = []
    for _ in range(60):
        error = gaussian_filter(rng.standard_normal((75, 80, 2)), (3, 3, 0))
        error /= error.std()
        scores.append(resting_height(sigma[..., None] * error, GRID) / spread)
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.2)
    assert spread[37, 40] > 1.3 * spread[5, 5]


def test_it_grows_with_the_slopes_and_with_the_reach_of_errors():
    sigma = np.full((75, 80), 0.02)
    none, one, twice = (HeightUncertainty(GRID, 2.0).sigma_m(f * sigma) for f in (0, 1, 2))
    assert twice == pytest.approx(2 * one) and (none == 0).all()
    assert HeightUncertainty(GRID, 6.0).sigma_m(sigma).mean() > 1.5 * one.mean()


def test_errors_along_the_slope_raise_the_whole_floor_and_nothing_beside_it():
    """Slopes that may be 10 % too steep all around a dent make it as much too deep."""
    sigma = 0.1 * np.linalg.norm(SLOPE, axis=-1)
    for length in (2.0, 4.0):
        along = HeightUncertainty(GRID, length).along_m(SLOPE, sigma)
        np.testing.assert_allclose(along, -0.1 * DENT, atol=5e-6)
    assert HeightUncertainty(GRID, 2.0).sigma_m(sigma)[37, 40] < 0.3 * along[37, 40]


def test_slopes_below_their_deviation_have_no_direction_that_errors_lie_along():
    sigma, trials = np.full((75, 80), 1.0), HeightUncertainty(GRID, 2.0)
    along = trials.along_m(SLOPE, sigma)
    assert trials.along_m(0.1 * SLOPE, sigma) == pytest.approx(0.1 * along)
    np.testing.assert_allclose(along, -DENT, atol=5e-5)


CURVE = DepthResponse("grey", np.array([0.0, 2.0, 20.0, 60.0]), np.array([0.0, 0.1, 0.5, 1.9]))


@given(st.lists(st.floats(0.0, 1.9), min_size=1, max_size=30))
def test_render_and_read_are_inverse(depths):
    depth, background = np.array([depths]), np.full((1, len(depths), 3), 160.0)
    found = CURVE.read(CURVE.render(depth, background), background)
    assert found.depth_mm == pytest.approx(depth, abs=1e-9)
    assert found.height_m == pytest.approx(-1e-3 * depth, abs=1e-12)


@given(st.lists(st.floats(-0.5, 1.9), min_size=1, max_size=30))
def test_gel_that_rises_is_drawn_brighter(depths):
    """Before, it was drawn as gel at rest."""
    depth, background = np.array([depths]), np.full((1, len(depths), 3), 160.0)
    drop = CURVE.drop(CURVE.render(depth, background), background)
    assert CURVE.signed_depth_of(drop) == pytest.approx(depth, abs=1e-9)


def test_brightening_reads_as_untouched_and_darkness_saturates():
    background = np.full((1, 3, 3), 100.0)
    image = background - np.array([-20.0, 30.0, 61.0])[None, :, None]
    found = CURVE.read(image, background)
    assert found.depth_mm[0] == pytest.approx([0.0, 0.85, 1.9])
    assert found.saturated.tolist() == [[False, False, True]]
    masked = CURVE.read(image, background, np.array([[True, False, True]]))
    assert masked.depth_mm[0] == pytest.approx([0.0, 0.0, 1.9])
    # A level stretch gives its first drop.
    level = DepthResponse("red", np.array([0.0, 5.0, 9.0, 12.0]), np.array([0.0, 0.4, 0.4, 0.8]))
    assert level.drop_of(np.array([0.4])) == pytest.approx(5.0)
    assert level.depth_of(np.array([7.0])) == pytest.approx(0.4)


def test_the_deviation_is_the_readings_at_rest_and_the_zeros_beside_it_in_contacts():
    sigmas = {"reading_sigma_mm": 0.03, "zero_sigma_mm": 0.4, "depth_share": 0.1}
    known = DepthResponse("grey", CURVE.drop_levels, CURVE.depth_mm, **sigmas)
    background = np.full((1, 4, 3), 100.0)
    image = background - np.array([-5.0, 1.0, 2.0, 60.0])[None, :, None]
    found, unknown = known.read(image, background), CURVE.read(image, background)
    parts = [(0, 0), (0.2, 0.005), (0.4, 0.01), (0.4, 0.19)]
    wanted = [np.hypot(0.03, np.hypot(*part)) for part in parts]
    assert found.sigma_mm[0] == pytest.approx(wanted)
    assert (found.reading_sigma_mm == 0.03).all()
    assert unknown.sigma_mm is None and unknown.reading_sigma_mm is None


def test_channels():
    image = np.array([[[10.0, 20.0, 30.0]]])
    assert channel_of(image, "green")[0, 0] == 20.0
    assert channel_of(image, "grey")[0, 0] == pytest.approx(image[0, 0] @ LUMA)


def test_bad_curves_are_refused():
    for drops, depths, words in (
        ((0.0, 0.0), (0.0, 1.0), "rising"),
        ((0.0, 1.0), (1.0, 0.5), "must not fall"),
        ((0.0, 1.0), (1.0,), "one length"),
    ):
        with pytest.raises(InputError, match=words):
            DepthResponse("grey", np.array(drops), np.array(depths))
    with pytest.raises(InputError, match="one size"):
        CURVE.read(np.zeros((2, 2, 3)), np.zeros((2, 3, 3)))
