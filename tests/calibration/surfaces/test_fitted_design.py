# SPDX-License-Identifier: Apache-2.0
"""The design that captures are simulated on: turned, made to measure, or the catalogue's."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.result import Severity
from taccel_lab.calibration.surfaces.design import MARGIN_MM, design_remarks, fitted_design
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.sensors.registry import sensor_family


def pad_size(profile: SensorProfile) -> np.ndarray:
    family = sensor_family(profile.sensor.family)
    pad = family.parameters(profile.sensor.parameters).pad()
    return np.ptp(pad.bounds_mm(), axis=0)[:2]


def test_upright_images_turn_the_pad() -> None:
    lying = fitted_design("gelsight_mini", PixelGrid(320, 240, 0.0511, 0.0511))
    upright = fitted_design("gelsight_mini", PixelGrid(240, 320, 0.0511, 0.0511))
    assert design_remarks("gelsight_mini", lying.camera.grid(), {}) == []
    (remark,) = design_remarks("gelsight_mini", PixelGrid(240, 320, 0.0511, 0.0511), {})
    assert remark.code == "pad_turned"
    assert pad_size(upright) == pytest.approx(pad_size(lying)[::-1])
    before, after = lying.sensor.parameters, upright.sensor.parameters
    assert after["crown_radius_x_mm"] == before["crown_radius_y_mm"]
    assert after["marker_pitch_mm"] == before["marker_pitch_mm"]


@pytest.mark.parametrize("sensor", ["gelsight", "gelsight_mini", "9dtact"])
def test_the_whole_sensor_is_turned(sensor: str) -> None:
    """Pads meshed across the catalogue's way were unfit to be simulated."""
    lying = fitted_design(sensor, PixelGrid(320, 240, 0.05, 0.05))
    upright = fitted_design(sensor, PixelGrid(240, 320, 0.05, 0.05))
    size = np.ptp(upright.mesh.nodes_m[:, :2], axis=0) * 1e3
    assert size == pytest.approx(pad_size(upright))
    assert upright.gel == lying.gel.replace(provenance=upright.gel.provenance)
    assert lying.optics is not None and upright.optics is not None
    assert upright.optics.width_px == lying.optics.height_px
    assert upright.camera.width_px == lying.camera.height_px


def test_a_pad_that_cannot_be_turned_is_told() -> None:
    """A DIGIT's gel is curved along one axis; its parameters have no x and y to exchange."""
    lying, upright = PixelGrid(320, 240, 0.05, 0.05), PixelGrid(240, 320, 0.05, 0.05)
    assert design_remarks("digit", upright, {}) == []
    (remark,) = design_remarks("digit", lying, {})
    assert remark.code == "images_across" and remark.severity is Severity.WARNING


def test_flat_pads_are_made_to_measure() -> None:
    grid = PixelGrid(400, 300, 0.07, 0.08)
    found = fitted_design("flat_pad", grid)
    assert found.sensor.family == "flat_pad"
    assert pad_size(found) == pytest.approx(
        [400 * 0.07 + 2 * MARGIN_MM, 300 * 0.08 + 2 * MARGIN_MM], abs=1e-3
    )
    assert found.camera.grid() == grid
    (remark,) = design_remarks("flat_pad", grid, {})
    assert remark.severity is Severity.WARNING and "4 mm thick" in remark.message
    known = {"thickness_mm": 2.5}
    assert fitted_design("flat_pad", grid, known).gel.thickness_mm == 2.5
    assert design_remarks("flat_pad", grid, known) == []


def test_a_view_larger_than_any_pad_is_refused() -> None:
    with pytest.raises(InputError, match="length_x_mm"):
        fitted_design("flat_pad", PixelGrid(640, 480, 0.2, 0.2))


def test_dimensions_given_win_over_the_turn() -> None:
    grid = PixelGrid(240, 320, 0.0511, 0.0511)
    found = fitted_design("gelsight_mini", grid, {"length_x_mm": 21.5})
    assert pad_size(found) == pytest.approx([21.5, 25.25])
    assert found.sensor.parameters["length_x_mm"] == 21.5


def test_an_unknown_sensor_is_refused_with_what_may_stand_for_it() -> None:
    with pytest.raises(InputError, match=r"no sensor 'gelsite'.*flat_pad stands for any flat gel"):
        fitted_design("gelsite", PixelGrid(320, 240, 0.05, 0.05))
