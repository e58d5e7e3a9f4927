# SPDX-License-Identifier: Apache-2.0
"""A table fitted to captures: its file, the folder made of it, and what taxim makes of that."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.interop.export import export_profile
from taccel_lab.interop.taxim_table import TaximTable, bin_indices, bin_middles
from taccel_lab.interop.taxim_table_file import (
    TABLE_FILE,
    TableFile,
    for_one_scale,
    read_table,
    write_table,
)
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.normals import normals_from_slopes, slopes_from_height
from tests.interop.presses import press_over_rest, psnr, require_upright
from tests.interop.test_taxim_folder import peer, render

BINS = 125


def lamp_table(bins: int = BINS) -> TaximTable:
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
    path = tmp_path / TABLE_FILE
    write_table(TableFile(lamp_table(9), (320, 240), {"heldout_disc_l1": 2.5}), path)
    found = read_table(path)
    assert np.array_equal(found.table.grad_rgb, lamp_table(9).grad_rgb)
    assert found.image_size_px == (320, 240) and found.figures == {"heldout_disc_l1": 2.5}
    # Taxim's own key and order: grad_r is blue.
    with np.load(path) as stored:
        assert int(stored["bins"]) == 9
        assert np.array_equal(stored["grad_r"], lamp_table(9).grad_rgb[2])


def test_files_of_others_are_read_without_size_and_figures(tmp_path: Path) -> None:
    np.savez(tmp_path / "t.npz", **lamp_table(9).arrays("bgr"))  # type: ignore[arg-type]
    found = read_table(tmp_path / "t.npz")
    assert found.image_size_px is None and not found.figures


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    with pytest.raises(InputError, match="does not exist"):
        read_table(path)
    path.write_bytes(b"PK no archive")
    with pytest.raises(InputError, match=r"^\S+/t\.npz is not a readable \.npz .* no zip archive"):
        read_table(path)
    with open(path, "wb") as stream:
        np.save(stream, np.zeros(3))
    with pytest.raises(InputError, match=r"^\S+/t\.npz is not a readable .* a single array"):
        read_table(path)
    good = lamp_table(9).arrays("bgr")
    for change, message in (
        ({"grad_g": good["grad_g"][:-1]}, r"grad_g of the Taxim table has shape \(8, 9, 6\)"),
        ({"grad_b": np.full((9, 9, 6), "x")}, "grad_b of the Taxim table has shape"),
        ({"grad_r": np.float64(1)}, "grad_"),
        ({"grad_r": np.full((9, 9, 6), np.nan)}, "NaN"),
        ({"grad_r": np.empty((9, 9, 6), dtype=object)}, "grad_r: it holds values of type object"),
        ({"image_size_px": np.array([1.5, 2.5])}, "image_size_px must be two whole numbers"),
    ):
        np.savez(path, **{**good, **change})  # type: ignore[arg-type]
        with pytest.raises(InputError, match=message):
            read_table(path)
    np.savez(path, figure_words=np.array("none"), **good)  # type: ignore[arg-type]
    assert read_table(path).figures == {}
    np.savez(path, grad_r=good["grad_r"])
    with pytest.raises(InputError, match="lacks grad_b, grad_g"):
        read_table(path)


def test_taxim_renders_the_fitted_table(mini: SensorProfile, tmp_path: Path) -> None:
    """Read back by taxim's own class; the colour model takes no part."""
    path = tmp_path / TABLE_FILE
    write_table(TableFile(lamp_table(), (320, 240), {"heldout_disc_l1": 2.5}), path)
    document = export_profile(mini.without("color"), "taxim", tmp_path / "calib", table=path)
    assert "fitted to captures" in document["carries"]["color"]
    assert document["approximations"]["table_heldout_disc_l1"] == 2.5
    press = press_over_rest(mini)
    simulator = peer(tmp_path / "calib", contact_scale=0.0)
    image = render(simulator, press.height_m * 1e3, with_shadow=False)
    assert mini.background_rgb is not None
    truth = np.clip(mini.background_rgb + lamp_table().change(press.normals), 0, 255)
    require_upright(image, truth, 48)
    at_rest = render(simulator, np.ones((240, 320)), with_shadow=False)
    assert np.abs(at_rest - mini.background_rgb).max() < 0.51


def test_gel_that_bulges_is_shown_from_a_map_below_the_gel(
    mini: SensorProfile, tmp_path: Path
) -> None:
    """taxim cuts what rises over the gel, with an edge; export.json says how to give it."""
    path = tmp_path / TABLE_FILE
    write_table(TableFile(lamp_table()), path)
    document = export_profile(mini, "taxim", tmp_path / "calib", table=path)
    assert any("rises over the gel" in note for note in document["notes"])
    simulator = peer(tmp_path / "calib", contact_scale=0.0)
    u, v = np.meshgrid(np.arange(320), np.arange(240))
    bulge_mm = 0.6 * np.exp(-((u - 150) ** 2 + (v - 120) ** 2) / (2 * 25.0**2)) - 0.1
    normals = normals_from_slopes(slopes_from_height(1e-3 * bulge_mm, mini.grid()))
    truth = np.clip(mini.background_rgb + lamp_table().change(normals), 0, 255)
    below = render(simulator, bulge_mm - bulge_mm.max(), with_shadow=False)
    assert psnr(below, truth) > 45
    cut = render(simulator, bulge_mm, with_shadow=False)
    assert psnr(cut, truth) < psnr(below, truth) - 6
    # The cut bulge shows the background.
    assert np.abs(cut[120, 165] - mini.background_rgb[120, 165]).max() < 1
    assert np.abs(below[120, 165] - mini.background_rgb[120, 165]).max() > 8


def test_other_bins_reach_the_reader(mini: SensorProfile, tmp_path: Path) -> None:
    write_table(TableFile(lamp_table(60)), tmp_path / "t.npz")
    document = export_profile(mini, "taxim", tmp_path / "calib", table=tmp_path / "t.npz")
    # This file says nothing of its images.
    assert any("it is taken as one of 320x240 px" in note for note in document["notes"])
    params = json.loads((tmp_path / "calib" / "params.json").read_text())
    assert params["sensor"]["num_bins"] == 60
    press = press_over_rest(mini)
    image = render(
        peer(tmp_path / "calib", contact_scale=0.0), press.height_m * 1e3, with_shadow=False
    )
    truth = np.clip(mini.background_rgb + lamp_table(60).change(press.normals), 0, 255)
    require_upright(image, truth, 42)


def test_two_scales_end_in_the_bins_that_are_looked_up() -> None:
    table, stretch = lamp_table(), np.array([0.9, 1.15])
    assert for_one_scale(table, np.ones(2)) is table
    seen = for_one_scale(table, stretch)
    slope = np.random.default_rng(0).normal(0, 0.5, (2000, 2))
    u, v = np.full(2000, 100.0), np.full(2000, 50.0)
    meant = table.change_at(normals_from_slopes(slope), u, v)
    shown = seen.change_at(normals_from_slopes(slope / stretch), u, v)
    # Half a bin of direction here and there.
    assert np.abs(shown - meant).max() < 4 and np.abs(shown - meant).mean() < 0.8
    unturned = table.change_at(normals_from_slopes(slope / stretch), u, v)
    assert np.abs(unturned - meant).mean() > 1.6


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
