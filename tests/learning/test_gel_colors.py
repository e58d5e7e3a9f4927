# SPDX-License-Identifier: Apache-2.0
"""Images of gels have colours without anybody giving some."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.learning.catalogue import make_vec
from taccel_lab.learning.gel_colors import default_colors
from taccel_lab.sensors.profile import catalogue_profile, stock_sensor


def test_a_tasks_gels_have_those_of_the_stock_sensor() -> None:
    env = make_vec("peg-insertion", 2, observe=("rgb", "depth_m"), size_px=(40, 30), device="cpu")
    first, _ = env.reset(seed=0)
    assert first["rgb"].shape == (2, 2, 30, 40, 3) and first["rgb"].dtype is torch.uint8
    starter = stock_sensor("gelsight_mini")
    assert starter.background_rgb is not None
    background = starter.background_rgb.reshape(30, 8, 40, 8, 3).mean(axis=(1, 3))
    assert np.abs(first["rgb"].numpy() - background).max() <= 1
    for _ in range(3):
        seen = env.step(torch.tensor([[0.0, 0.0, -1.0, 0.0]] * 2))[0]
    assert (seen["rgb"].int() - first["rgb"].int()).abs().max() > 3


def test_a_calibrated_sensor_has_its_own_and_its_cameras_pixels() -> None:
    pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
    sensor = stock_sensor("gelsight_mini")
    env = make_vec("grasp-lift", 1, sensor=sensor, observe=("rgb",), size_px=(64, 48), device="cpu")
    assert env.views.grids[0] == sensor.grid().resized(64, 48)
    first, _ = env.reset(seed=0)
    assert sensor.background_rgb is not None
    background = sensor.background_rgb.reshape(48, 5, 64, 5, 3).mean(axis=(1, 3))
    assert np.abs(first["rgb"][0, 0].numpy() - background).max() <= 1


def test_a_changed_design_has_those_of_its_familys_starter() -> None:
    thin = catalogue_profile("gelsight_mini", {"thickness_mm": 3})
    grid = PixelGrid(20, 15, 1.0, 1.0)
    model, image = default_colors(thin)(grid)
    wanted, _ = default_colors(stock_sensor("gelsight_mini"))(grid)
    assert image.shape == (15, 20, 3) and model.config == wanted.config


@pytest.mark.parametrize("name", ["digit", "9dtact"])
def test_a_sensor_without_colours_is_refused_with_what_to_do(name: str) -> None:
    with pytest.raises(InputError, match=f"{name} has no colour model.*calibrate color"):
        default_colors(stock_sensor(name))
