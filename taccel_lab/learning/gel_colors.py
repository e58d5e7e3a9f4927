# SPDX-License-Identifier: Apache-2.0
"""Colours for images of gels, where nobody gives others: those of the sensor, or of a starter."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.gel_faces import Colors

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile

STOCK = "gelsight_mini"
"""Whose colours gels of a task have: their size is its own."""


def default_colors(sensor: SensorProfile | None) -> Colors:
    """Colours that a sensor was calibrated with, else those of its family's starter profile. The
    gels of a task, which its image fills, have those of the starter of ``STOCK``.

    Raises:
        InputError: A sensor without a colour model, of a family without a starter.
    """
    from taccel_lab.sensors.profile import stock_sensor
    from taccel_lab.sensors.registry import sensor_families

    profile = sensor
    if profile is None:
        profile = stock_sensor(STOCK)
    elif profile.color is None and profile.sensor.family in sensor_families():
        profile = stock_sensor(profile.sensor.family)
    model, background = ColorModel.from_profile(profile), profile.background_rgb
    if model is None or background is None:
        raise InputError(
            f"rgb needs colours: {profile.sensor.name} has no colour model, and its family has no "
            "starter profile with one; calibrate it (taccel-lab calibrate color), or give "
            "colors: a function from a pixel grid to colour network and untouched image"
        )
    return _resized(model, background)


def _resized(model: ColorModel, background: np.ndarray) -> Colors:
    """The network and the image over as many pixels as are requested: both fill the view."""
    levels = torch.from_numpy(np.array(background, dtype=np.float32)).permute(2, 0, 1)[None]

    def colors(grid: PixelGrid) -> tuple[ColorModel, np.ndarray]:
        size = {"width_px": grid.width_px, "height_px": grid.height_px}
        image = torch.nn.functional.interpolate(
            levels, (grid.height_px, grid.width_px), mode="area"
        )
        sized = ColorModel(replace(model.config, **size), model.weights, model.cone_deg)
        return sized, image[0].permute(1, 2, 0).numpy()

    return colors
