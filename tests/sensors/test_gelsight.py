# SPDX-License-Identifier: Apache-2.0
"""The classic GelSight against the data it was taken from."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.sensors.gelsight.family import FAMILY


def gelmap() -> np.ndarray:
    """Height map of the gel in the package taxim [px], shape [480, 640]."""
    spec = importlib.util.find_spec("taxim")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("the package taxim is not installed")
    folder = Path(next(iter(spec.submodule_search_locations)))
    return np.load(folder / "calib" / "gelsight" / "gelmap.npy").astype(np.float64)


def test_dome_drops_1_40_mm_over_the_image() -> None:
    grid, pad = FAMILY.parameters().grid(), FAMILY.parameters().pad()
    corner = np.array([grid.x_mm()[-1], grid.y_mm()[-1]])
    assert -pad.height_mm(corner) == pytest.approx(1.40, abs=0.01)


def test_pad_matches_the_gel_map_everywhere() -> None:
    grid, pad = FAMILY.parameters().grid(), FAMILY.parameters().pad()
    measured = gelmap() * grid.mm_per_px_x - pad.thickness_mm
    xy = np.stack(np.meshgrid(grid.x_mm(), grid.y_mm()), axis=-1)
    error = pad.height_mm(xy) - measured
    assert np.sqrt((error**2).mean()) < 0.001
    assert np.abs(error).max() < 0.012


def test_a_press_fits_under_the_apex() -> None:
    # Deepest labelled press of the data: radius 1.976 mm with a 2 mm ball.
    depth = 2 - np.sqrt(2**2 - 1.976**2)
    assert FAMILY.parameters().pad().thickness_mm > 2 * depth


def test_material_is_in_si() -> None:
    material = FAMILY.parameters({"young_modulus_mpa": 0.3}).material()
    assert material.young_modulus_pa == pytest.approx(3e5)
    assert 0 <= material.poisson_ratio < 0.5


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"poisson_ratio": 0.5}, ["poisson_ratio = 0.5", "0 to 0.499"]),
        ({"young_modulus_mpa": -1}, ["young_modulus_mpa = -1"]),
        ({"thickness_mm": 1.6}, ["thickness_mm must be at least"]),
        ({"length_x_mm": 61}, ["length_x_mm = 61", "10 to 60 mm"]),
        ({"colour": "red"}, ["no parameter 'colour'", "thickness_mm"]),
        ({"width_px": 640.5}, ["width_px", "whole number"]),
    ],
)
def test_bad_parameters_name_sensor_and_bound(
    overrides: dict[str, object], words: list[str]
) -> None:
    with pytest.raises(InputError) as error:
        FAMILY.parameters(overrides)
    for word in ["sensor gelsight", *words]:
        assert word in str(error.value)
