# SPDX-License-Identifier: Apache-2.0
"""The pad under images of captures: turned, made to measure, and whether it lies under them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration import ball_presses
from taccel_lab.calibration.base_profile import base_profile, captures_on_pad
from taccel_lab.calibration.capture import ContactCircle, load_capture_folder
from taccel_lab.calibration.color.fit import calibrate_color
from taccel_lab.calibration.grey import fit as depth_fit
from taccel_lab.calibration.normals.fit import calibrate_normals
from taccel_lab.calibration.pad import (
    EDGE_MM,
    MARGIN_MM,
    OVERHANG_SHARE,
    design_remarks,
    fitted_design,
    fitted_parameters,
    inside_mm,
    looks_past_pad,
    pixels_on_pad,
    view_remarks,
)
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.report.remark import Severity
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import profile_parameters, sensor_families, sensor_family
from tests.support.synthetic_presses import GRID, flat_background, synthetic_captures, write_folder


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


@pytest.mark.thorough
def test_flat_pads_are_made_to_measure() -> None:
    grid = PixelGrid(400, 300, 0.07, 0.08)
    found = fitted_design("flat_pad", grid)
    assert found.sensor.family == "flat_pad"
    assert pad_size(found) == pytest.approx(
        [400 * 0.07 + 2 * MARGIN_MM, 300 * 0.08 + 2 * MARGIN_MM], abs=1e-3
    )
    assert found.camera.grid() == grid
    (remark,) = design_remarks("flat_pad", grid, {})
    assert remark.severity is Severity.WARNING and "4 mm where nothing tells it" in remark.message
    known = {"thickness_mm": 2.5}
    assert fitted_design("flat_pad", grid, known).gel.thickness_mm == 2.5
    assert design_remarks("flat_pad", grid, known) == []


def test_a_view_larger_than_any_pad_is_refused() -> None:
    wide = PixelGrid(640, 480, 0.2, 0.2)
    with pytest.raises(InputError, match=r"128.0 x 96.0 mm, more than the pad of 60 x 60 mm"):
        fitted_design("flat_pad", wide)
    with pytest.raises(InputError, match="length_x_mm"):
        fitted_design("flat_pad", wide, {"length_x_mm": 140.0, "length_y_mm": 100.0})


@pytest.mark.thorough
def test_dimensions_given_win_over_the_turn() -> None:
    grid = PixelGrid(240, 320, 0.0511, 0.0511)
    found = fitted_design("gelsight_mini", grid, {"length_x_mm": 21.5})
    assert pad_size(found) == pytest.approx([21.5, 25.25])
    assert found.sensor.parameters["length_x_mm"] == 21.5


def test_an_unknown_sensor_is_refused_with_what_may_stand_for_it() -> None:
    with pytest.raises(InputError, match=r"no sensor 'gelsite'.*flat_pad stands for any flat gel"):
        fitted_design("gelsite", PixelGrid(320, 240, 0.05, 0.05))


MINI = sensor_family("gelsight_mini").parameters()


@pytest.mark.thorough
@settings(max_examples=30)
@given(scale=st.floats(0.05, 0.1), v_px=st.floats(100, 140))
def test_what_is_left_out_lies_beside_the_pad_or_at_its_edge(scale: float, v_px: float) -> None:
    """For a lens whose middle is not over the pad's, too."""
    grid = PixelGrid(320, 240, scale, scale, center_v_px=v_px)
    x, y = np.meshgrid(grid.x_mm(), grid.y_mm())
    exact = MINI.pad().inside_distance_mm(np.stack([x, y], axis=-1))
    assert np.abs(inside_mm(MINI, grid) - exact)[exact < 1].max(initial=0) < 0.1
    codes = {remark.code: remark.severity for remark in view_remarks(MINI, grid)}
    least = exact.min()
    near = [0.0, EDGE_MM, -OVERHANG_SHARE * 25.25]
    if min(abs(least - limit) for limit in near) > 0.1:
        expected = (
            {"scale_past_pad": Severity.ERROR}
            if least < near[2]
            else {"pad_edge": Severity.WARNING}
            if least < 0
            else {"pad_edge": Severity.INFO}
            if least < EDGE_MM
            else {}
        )
        assert codes == expected


def test_what_is_masked_does_not_count() -> None:
    grid = PixelGrid(320, 240, 0.09, 0.09)
    (past,) = view_remarks(MINI, grid)
    assert past.severity == Severity.ERROR and "28.8 x 21.6 mm, more than" in past.message
    assert view_remarks(MINI, grid, inside_mm(MINI, grid) > 1.0) == []


@pytest.mark.parametrize("name", sensor_families())
def test_cameras_of_the_catalogue_show_their_pads(name: str) -> None:
    parameters = sensor_family(name).parameters()
    found = view_remarks(parameters, parameters.grid())
    # Domes are read beside their plan, but no layer stands for them there.
    assert [remark.blocks for remark in found] == [("color",)] * looks_past_pad(parameters)


@pytest.mark.thorough(cases=("digit-size0", "flat_pad-size0"))
@pytest.mark.parametrize("size", [(320, 240), (240, 320)])
@pytest.mark.parametrize("sensor", ["gelsight_mini", "digit", "flat_pad"])
def test_the_check_looks_at_the_pad_that_is_designed(sensor: str, size: tuple[int, int]) -> None:
    grid = PixelGrid(*size, 0.05, 0.05)
    profile = fitted_design(sensor, grid, {})
    assert fitted_parameters(sensor, grid, {}).pad() == profile_parameters(profile).pad()
    mask = np.ones(size[::-1], dtype=bool)
    assert pixels_on_pad(profile, grid, mask) is mask


@pytest.mark.parametrize("fault", ["view", "label"])
@pytest.mark.parametrize(
    "calibrate", [calibrate_color, calibrate_normals, depth_fit.calibrate_depth]
)
def test_calibrations_refuse_before_they_look_at_a_press(
    calibrate: Callable[..., Any], fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = flat_background().round().astype(np.uint8)
    circle = ContactCircle(170.0, 60.0, 15.0) if fault == "label" else ContactCircle(80, 60, 15)
    path = write_folder(tmp_path / "c", image, {"p": image}, {"p": circle})
    manifest = path / "captures.toml"
    if fault == "view":
        stated = f"= {GRID.mm_per_px_x}"
        manifest.write_text(manifest.read_text().replace(stated, "= 0.2"))
    folder = load_capture_folder(path)
    looked: list[object] = []
    for module in (ball_presses, depth_fit):
        monkeypatch.setattr(module, "capture_findings", lambda *_: looked.append(1) or [])
    words = {"view": "32.0 x 24.0 mm, more than the pad", "label": "its centre has to be inside"}
    with pytest.raises(InputError, match=words[fault]):
        calibrate(folder, base_profile(None, folder))
    assert not looked


def test_an_image_up_to_the_edge_is_used_without_it() -> None:
    base = catalogue_profile("gelsight")
    wide = replace(synthetic_captures(1)[0], grid=PixelGrid(160, 120, 0.15, 0.15))
    kept = captures_on_pad(wide, base).mask
    inside = inside_mm(profile_parameters(base), wide.grid)
    assert not kept[inside < 0].any() and kept[inside > 1].all() and not kept.all()
