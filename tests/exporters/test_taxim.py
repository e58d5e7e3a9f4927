# SPDX-License-Identifier: Apache-2.0
"""Taxim's colour table: bins, files, distillation, and the folder as PyPI's taxim renders it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.exporters.export import export_profile
from taccel_lab.exporters.press_samples import ColorSource
from taccel_lab.exporters.taxim_distil import _image_fit, distil_table
from taccel_lab.exporters.taxim_table import (
    TABLE_FILE,
    TableFile,
    TaximTable,
    bin_indices,
    bin_middles,
    bin_steps,
    one_scale,
    pixel_terms,
    read_table,
    write_table,
)
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.normals import normals_from_slopes, slopes_from_height
from tests.exporters.conftest import Exported
from tests.exporters.consumers import taxim, taxim_render
from tests.exporters.profiles import (
    our_image,
    press_over_rest,
    psnr,
    require_upright,
    with_encoding,
)

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
    gradient = bin_indices(normals, 120, "gradient")
    np.testing.assert_array_equal(gradient, bin_indices(normals * [-1, -1, 1], 120))


def test_change_is_the_polynomial_of_the_bin() -> None:
    grad, normal = np.zeros((3, 4, 4, 6)), np.array([0.5, 0.0, 0.8])
    tilt, angle = bin_indices(normal, 4)
    grad[1, tilt, angle] = [1, 2, 3, 4, 5, 6]
    u, v = 4, 2
    change = TaximTable(4, grad).change(np.broadcast_to(normal, (3, 5, 3)))
    assert change[v, u].tolist() == [0, 16 + 2 * 4 + 3 * 8 + 16 + 10 + 6, 0]
    assert pixel_terms(u, v).tolist() == [16, 4, 8, 4, 2, 1]


@pytest.mark.thorough
def test_a_distilled_table_shows_what_the_model_shows(mini: SensorProfile) -> None:
    made, press = distil_table(mini, 125), press_over_rest(mini)
    assert mini.background_rgb is not None
    shown, truth = mini.background_rgb + made.table.change(press.normals), our_image(mini, press)
    assert psnr(shown, truth) > 48
    # The error that it states is that of presses that it was not made from.
    stated = made.errors["table_rms_levels"]
    assert np.sqrt(((shown - truth) ** 2).mean()) < 1.5 * stated
    assert stated < 0.08 * made.errors["model_rms_levels"]
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


@pytest.mark.thorough(cases=("region1",))
@pytest.mark.parametrize(
    "region",
    [
        {},
        {"displacement_mm": (0.0, 0.1)},
        {"displacement_mm": (-1.0, 0.0), "surface_tilt_deg": (0.0, 0.5)},
    ],
)
def test_any_valid_region_gives_a_table(region: dict, mini: SensorProfile) -> None:
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


@pytest.mark.thorough
def test_taxim_renders_the_press_as_the_profile_does(mini: SensorProfile, tmp_path: Path) -> None:
    """Of two scales, which end in the bins that taxim looks up by its one."""
    mini = mini.with_block(mini.camera.replace(mm_per_px_x=0.09, mm_per_px_y=0.045))
    document = export_profile(mini, "taxim", tmp_path / "calib")
    assert document["approximations"]["scale_difference"] == pytest.approx(1.0)
    assert document["approximations"]["table_rms_levels"] < 1
    # The surface is given, so that only the optics is compared.
    simulator = taxim(tmp_path / "calib", contact_scale=0.0)
    assert (simulator.width, simulator.height) == (320, 240)
    assert simulator.sensor_params.pixmm == pytest.approx((0.09 * 0.045) ** 0.5)
    press = press_over_rest(mini)
    image = taxim_render(simulator, press.height_m * 1e3, with_shadow=False)
    require_upright(image, our_image(mini, press), 50)


@pytest.mark.slow
def test_the_neutral_shadows_change_nothing(mini: SensorProfile, exported: Exported) -> None:
    press = press_over_rest(mini)
    simulator = taxim(exported("taxim")[0], contact_scale=0.0)
    image = taxim_render(simulator, press.height_m * 1e3, with_shadow=True)
    require_upright(image, our_image(mini, press), 50)


def lamp_table(bins: int = 125) -> TaximTable:
    """Three lamps at 120 degrees, brighter on the right and, in green, at the bottom."""
    normals = bin_middles(bins)
    grad = np.zeros((3, bins, bins, 6))
    for channel in range(3):
        angle = 2 * np.pi * channel / 3 + 0.2
        toward = normals[..., 0] * np.cos(angle) + normals[..., 1] * np.sin(angle)
        grad[channel, ..., 5] = 60 * toward
        grad[channel, ..., 3] = 0.1 * toward
    grad[1, ..., 4] = 0.05 * normals[..., 0]
    grad[:, 0] = 0.0
    return TaximTable(bins, grad)


@given(st.integers(2, 200))
def test_middles_of_bins_lie_in_them(bins: int) -> None:
    tilt, direction = bin_indices(bin_middles(bins), bins)
    assert (tilt[:-1] == np.arange(bins - 1)[:, None]).all()
    # The last direction is the first, a whole turn on.
    assert (direction[:, :-1] == np.arange(bins - 1)).all()


def test_the_file_keeps_table_size_and_figures(tmp_path: Path) -> None:
    path, table = tmp_path / TABLE_FILE, lamp_table(9)
    write_table(TableFile(table, (320, 240), {"heldout_disc_l1": 2.5}), path)
    found = read_table(path)
    assert np.array_equal(found.table.grad_rgb, table.grad_rgb)
    assert found.image_size_px == (320, 240) and found.figures == {"heldout_disc_l1": 2.5}
    # Taxim's own key and order: grad_r is blue.
    with np.load(path) as stored:
        assert int(stored["bins"]) == 9
        assert np.array_equal(stored["grad_r"], table.grad_rgb[2])
    rgb = TaximTable.from_arrays(table.arrays("rgb"), "rgb")
    assert rgb.bins == 9 and np.array_equal(rgb.grad_rgb, table.grad_rgb)
    assert np.array_equal(table.arrays("rgb")["grad_r"], table.grad_rgb[0])
    # Files of others say nothing of size and figures; words are no figures.
    for words in ({}, {"figure_words": np.array("none")}):
        np.savez(path, **words, **table.arrays("bgr"))  # type: ignore[arg-type]
        found = read_table(path)
        assert found.image_size_px is None and found.figures == {}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grad_g": np.zeros((8, 9, 6))}, r"grad_g of the Taxim table has shape \(8, 9, 6\)"),
        ({"grad_b": np.full((9, 9, 6), "x")}, "grad_b of the Taxim table has shape"),
        ({"grad_r": np.float64(1)}, "grad_"),
        ({"grad_r": np.full((9, 9, 6), np.nan)}, "NaN"),
        ({"grad_r": np.empty((9, 9, 6), dtype=object)}, "grad_r: it holds values of type object"),
        ({"image_size_px": np.array([1.5, 2.5])}, "image_size_px must be two whole numbers"),
        ({"grad_b": None, "grad_g": None}, "lacks grad_b, grad_g"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, change: dict, message: str) -> None:
    arrays = {**lamp_table(9).arrays("bgr"), **change}
    kept = {name: value for name, value in arrays.items() if value is not None}
    np.savez(tmp_path / "t.npz", **kept)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        read_table(tmp_path / "t.npz")


@pytest.mark.thorough
def test_taxim_renders_the_fitted_table(mini: SensorProfile, tmp_path: Path) -> None:
    """By taxim's own class, with other bins than its own; no colour model takes part. It cuts what
    rises over the gel, with an edge; export.json says how to give the map of a gel that bulges."""
    path, table = tmp_path / TABLE_FILE, lamp_table(250)
    write_table(TableFile(table, None, {"heldout_disc_l1": 2.5}), path)
    document = export_profile(mini.without("color"), "taxim", tmp_path / "calib", table=path)
    assert "fitted to captures" in document["carries"]["color"]
    assert document["approximations"]["table_heldout_disc_l1"] == 2.5
    # This file says nothing of its images.
    for words in ("it is taken as one of 320x240 px", "rises over the gel"):
        assert any(words in note for note in document["notes"])
    params = json.loads((tmp_path / "calib" / "params.json").read_text())
    assert params["sensor"]["num_bins"] == 250
    simulator, rest = taxim(tmp_path / "calib", contact_scale=0.0), mini.background_rgb
    assert rest is not None

    def rendered(height_mm: np.ndarray) -> np.ndarray:
        return taxim_render(simulator, height_mm, with_shadow=False)

    press = press_over_rest(mini)
    truth = np.clip(rest + table.change(press.normals), 0, 255)
    require_upright(rendered(press.height_m * 1e3), truth, 48)
    # f0 is rounded to 8 bit.
    assert np.abs(rendered(np.ones((240, 320))) - rest).max() < 0.51
    u, v = np.meshgrid(np.arange(320), np.arange(240))
    bulge_mm = 0.6 * np.exp(-((u - 150) ** 2 + (v - 120) ** 2) / (2 * 25.0**2)) - 0.1
    normals = normals_from_slopes(slopes_from_height(1e-3 * bulge_mm, mini.grid()))
    truth = np.clip(rest + table.change(normals), 0, 255)
    below, cut = rendered(bulge_mm - bulge_mm.max()), rendered(bulge_mm)
    assert psnr(below, truth) > 45 and psnr(cut, truth) < psnr(below, truth) - 6
    # The cut bulge shows the background.
    assert np.abs(cut - rest)[120, 165].max() < 1 and np.abs(below - rest)[120, 165].max() > 8


def test_a_table_of_other_images_and_other_formats_are_refused(
    mini: SensorProfile, tmp_path: Path
) -> None:
    path = tmp_path / TABLE_FILE
    write_table(TableFile(lamp_table(9), (640, 480)), path)
    with pytest.raises(InputError, match="640x480 px, the profile's are 320x240 px"):
        export_profile(mini, "taxim", tmp_path / "out", table=path)
    with pytest.raises(InputError, match="taxim only, not to isaac-lab"):
        export_profile(mini, "isaac-lab", tmp_path / "out", table=path)
    assert not (tmp_path / "out").exists()
