# SPDX-License-Identifier: Apache-2.0
"""The folder is loaded and rendered by PyPI's taxim itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.interop.export import export_profile
from taccel_lab.profile import SensorProfile
from tests.interop.presses import our_image, press_over_rest, psnr, require_upright


def peer(folder: Path, **simulator: object) -> Any:
    taxim = pytest.importorskip("taxim", reason="PyPI's taxim is not installed")
    pytest.importorskip("jax", reason="taxim needs jax or torch-scatter")
    return taxim.Taxim(calib_folder=folder, backend="jax", params={"simulator": simulator})


def render(simulator: Any, height_mm: np.ndarray, **options: object) -> np.ndarray:
    return 255 * np.asarray(simulator.render_direct(height_mm.astype(np.float32), **options))


def test_taxim_renders_the_press_as_the_profile_does(mini: SensorProfile, tmp_path: Path) -> None:
    document = export_profile(mini, "taxim", tmp_path / "calib")
    # The surface is given, so that only the optics is compared.
    simulator = peer(tmp_path / "calib", contact_scale=0.0)
    assert (simulator.width, simulator.height) == (320, 240)
    assert simulator.sensor_params.pixmm == pytest.approx(0.0634)
    press = press_over_rest(mini)
    truth = our_image(mini, press)
    require_upright(render(simulator, press.height_m * 1e3, with_shadow=False), truth, 50)
    at_rest = render(simulator, np.ones((240, 320)), with_shadow=False)
    assert mini.background_rgb is not None
    # f0 is rounded to 8 bit.
    assert np.abs(at_rest - mini.background_rgb).max() < 0.51
    assert document["approximations"]["table_rms_levels"] < 1


@pytest.mark.slow
def test_the_neutral_shadows_change_nothing(mini: SensorProfile, tmp_path: Path) -> None:
    export_profile(mini, "taxim", tmp_path / "calib")
    press = press_over_rest(mini)
    simulator = peer(tmp_path / "calib", contact_scale=0.0)
    image = render(simulator, press.height_m * 1e3, with_shadow=True)
    require_upright(image, our_image(mini, press), 50)


def test_taxim_presses_an_object_into_it(mini: SensorProfile, tmp_path: Path) -> None:
    """With Taxim's own model of the gel, from an object's height map."""
    export_profile(mini, "taxim", tmp_path / "calib")
    press = press_over_rest(mini)
    grid = mini.grid()
    du = (np.arange(320)[None] - 220) * grid.mm_per_px_x
    dv = (np.arange(240)[:, None] - 90) * grid.mm_per_px_y
    ball = 4.0 - np.sqrt(np.maximum(16 - du**2 - dv**2, 0))
    image = render(peer(tmp_path / "calib"), ball, with_shadow=False, press_depth=press.depth_mm)
    truth = our_image(mini, press)
    at_best = psnr(image, truth)
    assert mini.background_rgb is not None
    assert at_best > psnr(np.asarray(mini.background_rgb), truth)
    assert at_best > psnr(image[:, ::-1], truth) + 5
    assert at_best > psnr(image[::-1], truth) + 5


def test_two_scales_end_in_the_bins_that_taxim_looks_up(
    mini: SensorProfile, tmp_path: Path
) -> None:
    camera = mini.camera.replace(mm_per_px_x=0.07, mm_per_px_y=0.055)
    stretched = mini.with_block(camera)
    document = export_profile(stretched, "taxim", tmp_path / "calib")
    assert document["approximations"]["scale_difference"] == pytest.approx(0.07 / 0.055 - 1)
    press = press_over_rest(stretched)
    image = render(
        peer(tmp_path / "calib", contact_scale=0.0), press.height_m * 1e3, with_shadow=False
    )
    require_upright(image, our_image(stretched, press), 48)


def test_the_map_of_the_gel_is_its_thickness_in_pixels(mini: SensorProfile, tmp_path: Path) -> None:
    profile = mini.with_block(mini.camera.replace(mm_per_px_y=1.21 * mini.camera.mm_per_px_x))
    export_profile(profile, "taxim", tmp_path / "out")
    gel = np.load(tmp_path / "out" / "gelmap.npy")
    assert gel.shape == (240, 320)
    # Of the one scale that Taxim knows: the mean of both, as a product.
    pixel_mm = 1.1 * mini.camera.mm_per_px_x
    np.testing.assert_allclose(gel, mini.gel.thickness_mm / pixel_mm)
