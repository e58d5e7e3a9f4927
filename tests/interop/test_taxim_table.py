# SPDX-License-Identifier: Apache-2.0
"""The colour table: bins as Taxim computes them, files, distillation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.interop.press_samples import ColorSource
from taccel_lab.interop.taxim_distil import _image_fit, distil_table
from taccel_lab.interop.taxim_table import (
    TaximTable,
    bin_indices,
    bin_steps,
    one_scale,
    pixel_terms,
)
from taccel_lab.profile import SensorProfile
from tests.interop.presses import our_image, press_over_rest, psnr
from tests.interop.profiles import with_encoding

SLOPE = st.floats(-5, 5)


@given(SLOPE, SLOPE, st.integers(2, 200))
def test_bins_are_those_of_taxim(dh_dx: float, dh_dy: float, bins: int) -> None:
    normal = np.array([-dh_dx, -dh_dy, 1.0])
    # taxim_torch.py: gradients of the height into the gel, rows first.
    dz_drow, dz_dcolumn = -dh_dy, -dh_dx
    magnitude = np.arctan(np.hypot(dz_drow, dz_dcolumn))
    direction = np.arctan2(dz_drow, dz_dcolumn) if magnitude else 0.0
    tilt, angle = bin_indices(normal, bins)
    step_tilt, step_angle = bin_steps(bins)
    # Within rounding of a bin's edge.
    assert abs((tilt + 0.5) * step_tilt - magnitude) <= 0.5 * step_tilt * (1 + 1e-9)
    assert abs((angle + 0.5) * step_angle - np.pi - direction) <= 0.5 * step_angle * (1 + 1e-9)


def test_gradient_bins_lie_half_a_turn_away() -> None:
    normals = np.array([[0.3, 0.1, 0.9], [-0.2, 0.4, 0.8]])
    turned = normals * [-1, -1, 1]
    for one, other in zip(
        bin_indices(normals, 120, "gradient"), bin_indices(turned, 120), strict=True
    ):
        assert (one == other).all()


def test_a_table_round_trips_through_both_channel_orders() -> None:
    rng = np.random.default_rng(0)
    table = TaximTable(5, rng.normal(size=(3, 5, 5, 6)))
    assert np.array_equal(table.arrays("bgr")["grad_r"], table.grad_rgb[2])
    assert np.array_equal(table.arrays("rgb")["grad_r"], table.grad_rgb[0])
    for order in ("rgb", "bgr"):
        again = TaximTable.from_arrays(table.arrays(order), order)
        assert again.bins == 5 and np.array_equal(again.grad_rgb, table.grad_rgb)


def test_change_is_the_polynomial_of_the_bin() -> None:
    grad = np.zeros((3, 4, 4, 6))
    normal = np.array([0.5, 0.0, 0.8])
    tilt, angle = bin_indices(normal, 4)
    grad[1, tilt, angle] = [1, 2, 3, 4, 5, 6]
    change = TaximTable(4, grad).change(np.broadcast_to(normal, (3, 5, 3)))
    u, v = 4, 2
    assert change[v, u].tolist() == [0, 16 + 2 * 4 + 3 * 8 + 16 + 10 + 6, 0]
    assert pixel_terms(u, v).tolist() == [16, 4, 8, 4, 2, 1]


def test_damaged_tables_are_refused() -> None:
    with pytest.raises(InputError, match="shape"):
        TaximTable(4, np.zeros((3, 4, 5, 6)))
    with pytest.raises(InputError, match="NaN"):
        TaximTable(2, np.full((3, 2, 2, 6), np.nan))
    with pytest.raises(InputError, match="grad_b"):
        TaximTable.from_arrays({"grad_r": np.zeros(1), "grad_g": np.zeros(1)}, "rgb")


def test_a_distilled_table_shows_what_the_model_shows(mini: SensorProfile) -> None:
    made = distil_table(mini, 125)
    press = press_over_rest(mini)
    assert mini.background_rgb is not None
    shown = mini.background_rgb + made.table.change(press.normals)
    truth = our_image(mini, press)
    assert psnr(shown, truth) > 48
    # The error that it states is that of presses that it was not made from.
    assert made.errors["table_rms_levels"] < 0.08 * made.errors["model_rms_levels"]
    off = np.sqrt(((shown - truth) ** 2).mean())
    assert off < made.errors["table_rms_levels"] * 1.5
    assert not made.table.grad_rgb[:, 0].any()


def test_bands_do_not_fall_in_step_with_the_pixels_that_are_asked(mini: SensorProfile) -> None:
    """A band of eight periods, on eight evenly spaced columns, would look like a constant."""
    encoded = with_encoding(mini, 4)
    weights = dict(encoded.color_weights or {})
    first = weights["layer0.weight"].copy()
    first[:, 6:] = 0.0
    first[:, 6 + 4 * 3 + 2] = 1.0  # cos(8 pi u): one on every asked pixel of the plain grid
    assert encoded.color is not None
    waves = encoded.with_block(encoded.color, {**weights, "layer0.weight": first})
    source, rng = ColorSource(waves), np.random.default_rng(0)
    pixels, solve = _image_fit(source, rng)
    columns = pixels % 320
    wave = np.cos(8 * np.pi * (2 * columns / 319 - 1))
    assert abs(wave.mean()) < 0.2 and np.ptp(wave) > 1.5
    # Still the least squares of the six terms, over pixels that span the image.
    terms = pixel_terms(columns, pixels // 320)
    assert solve @ (terms @ np.arange(1.0, 7.0)) == pytest.approx(np.arange(1.0, 7.0), rel=1e-6)
    assert np.ptp(columns) > 280 and np.ptp(pixels // 320) > 200


@pytest.mark.parametrize(
    "region",
    [
        {},
        {"displacement_mm": (0.0, 0.1)},
        {"displacement_mm": (-1.0, 0.0), "surface_tilt_deg": (0.0, 0.5)},
    ],
)
def test_any_valid_region_gives_a_table(
    region: dict[str, tuple[float, float]], mini: SensorProfile
) -> None:
    """Also of a colour block that was fitted to next to nothing, or says nothing."""
    assert mini.color is not None
    provenance = mini.color.provenance.replace(kind="assumed", valid_region=region)
    block = mini.color.replace(provenance=provenance)
    made = distil_table(mini.with_block(block, mini.color_weights), 20)
    assert np.isfinite(made.table.grad_rgb).all()
    assert 5 <= made.errors["steepest_tilt_deg"] <= 80


def test_a_reader_of_one_scale_measures_other_slopes() -> None:
    """On a plane: what it takes for a pixel's width along each axis is the mean of both."""
    grid = PixelGrid(40, 30, 0.04, 0.09)
    scale, stretch = one_scale(grid)
    assert scale == pytest.approx(0.06)
    x, y = grid.x_mm(), grid.y_mm()
    height_px = (0.3 * x[None, :] - 0.2 * y[:, None]) / scale
    measured = [np.diff(height_px, axis=axis).mean() for axis in (1, 0)]
    np.testing.assert_allclose(np.array(measured) * stretch, [0.3, -0.2])
