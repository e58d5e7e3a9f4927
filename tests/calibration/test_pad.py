# SPDX-License-Identifier: Apache-2.0
"""The pad under images of captures: turned, made to measure, and whether it lies under them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration import ball_presses
from taccel_lab.calibration import pad as pads
from taccel_lab.calibration.base_profile import base_profile, captures_on_pad
from taccel_lab.calibration.capture import ContactCircle, load_capture_folder
from taccel_lab.calibration.color.fit import calibrate_color
from taccel_lab.calibration.depth import fit as depth_fit
from taccel_lab.calibration.normals.fit import calibrate_normals
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.report.remark import Severity
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import profile_parameters, sensor_families, sensor_family
from tests.support.capture_sets import edit_manifest
from tests.support.synthetic_presses import flat_background, synthetic_captures, write_folder

LYING, UPRIGHT = PixelGrid(320, 240, 0.05, 0.05), PixelGrid(240, 320, 0.05, 0.05)
MINI = sensor_family("gelsight_mini").parameters()


def pad_size(profile: SensorProfile) -> np.ndarray:
    return np.ptp(profile_parameters(profile).pad().bounds_mm(), axis=0)[:2]


@pytest.mark.parametrize("sensor", ["gelsight", "gelsight_mini", "9dtact"])
def test_upright_images_turn_the_whole_sensor(sensor: str) -> None:
    """Pads meshed across the catalogue's way were unfit to be simulated."""
    lying, upright = (pads.fitted_design(sensor, grid) for grid in (LYING, UPRIGHT))
    assert pads.design_remarks(sensor, LYING, {}) == []
    (remark,) = pads.design_remarks(sensor, UPRIGHT, {})
    assert remark.code == "pad_turned"
    size = np.ptp(upright.mesh.nodes_m[:, :2], axis=0) * 1e3
    assert size == pytest.approx(pad_size(upright))
    assert pad_size(upright) == pytest.approx(pad_size(lying)[::-1])
    assert upright.gel == lying.gel.replace(provenance=upright.gel.provenance)
    assert lying.optics is not None and upright.optics is not None
    assert upright.optics.width_px == lying.optics.height_px
    assert upright.camera.width_px == lying.camera.height_px
    if sensor == "gelsight_mini":
        before, after = lying.sensor.parameters, upright.sensor.parameters
        assert after["crown_radius_x_mm"] == before["crown_radius_y_mm"]
        assert after["marker_pitch_mm"] == before["marker_pitch_mm"]
        # Dimensions that are given win over the turn.
        given = pads.fitted_design(sensor, UPRIGHT, {"length_x_mm": 21.5})
        assert pad_size(given) == pytest.approx([21.5, 25.25])
        assert given.sensor.parameters["length_x_mm"] == 21.5


def test_a_pad_that_cannot_be_turned_is_told() -> None:
    """A DIGIT's gel is curved along one axis; its parameters have no x and y to exchange."""
    assert pads.design_remarks("digit", UPRIGHT, {}) == []
    (remark,) = pads.design_remarks("digit", LYING, {})
    assert remark.code == "images_across" and remark.severity is Severity.WARNING


@pytest.mark.thorough
def test_flat_pads_are_made_to_measure() -> None:
    grid = PixelGrid(400, 300, 0.07, 0.08)
    found = pads.fitted_design("flat_pad", grid)
    size = np.array([400 * 0.07, 300 * 0.08]) + 2 * pads.MARGIN_MM
    assert found.sensor.family == "flat_pad" and found.camera.grid() == grid
    assert pad_size(found) == pytest.approx(size, abs=1e-3)
    (remark,) = pads.design_remarks("flat_pad", grid, {})
    assert remark.severity is Severity.WARNING and "4 mm where nothing tells it" in remark.message
    known = {"thickness_mm": 2.5}
    assert pads.fitted_design("flat_pad", grid, known).gel.thickness_mm == 2.5
    assert pads.design_remarks("flat_pad", grid, known) == []


@pytest.mark.parametrize(
    ("sensor", "design", "said"),
    [
        ("flat_pad", {}, r"128.0 x 96.0 mm, more than the pad of 60 x 60 mm"),
        ("flat_pad", {"length_x_mm": 140.0, "length_y_mm": 100.0}, "length_x_mm"),
        ("gelsite", {}, r"no sensor 'gelsite'.*flat_pad stands for any flat gel"),
    ],
)
def test_views_larger_than_any_pad_and_unknown_sensors_are_refused(sensor, design, said) -> None:
    with pytest.raises(InputError, match=said):
        pads.fitted_design(sensor, PixelGrid(640, 480, 0.2, 0.2), design)


@pytest.mark.thorough
@settings(max_examples=30)
@given(scale=st.floats(0.05, 0.1), v_px=st.floats(100, 140))
def test_what_is_left_out_lies_beside_the_pad_or_at_its_edge(scale: float, v_px: float) -> None:
    """For a lens whose middle is not over the pad's, too."""
    grid = PixelGrid(320, 240, scale, scale, center_v_px=v_px)
    x, y = np.meshgrid(grid.x_mm(), grid.y_mm())
    exact = MINI.pad().inside_distance_mm(np.stack([x, y], axis=-1))
    assert np.abs(pads.inside_mm(MINI, grid) - exact)[exact < 1].max(initial=0) < 0.1
    codes = {remark.code: remark.severity for remark in pads.view_remarks(MINI, grid)}
    least = exact.min()
    steps = {
        -pads.OVERHANG_SHARE * 25.25: {"scale_past_pad": Severity.ERROR},
        0.0: {"pad_edge": Severity.WARNING},
        pads.EDGE_MM: {"pad_edge": Severity.INFO},
    }
    if min(abs(least - limit) for limit in steps) > 0.1:
        assert codes == next((told for limit, told in steps.items() if least < limit), {})


def test_what_is_masked_does_not_count() -> None:
    grid = PixelGrid(320, 240, 0.09, 0.09)
    (past,) = pads.view_remarks(MINI, grid)
    assert past.severity == Severity.ERROR and "28.8 x 21.6 mm, more than" in past.message
    assert pads.view_remarks(MINI, grid, pads.inside_mm(MINI, grid) > 1.0) == []


@pytest.mark.parametrize("name", sensor_families())
def test_cameras_of_the_catalogue_show_their_pads(name: str) -> None:
    parameters = sensor_family(name).parameters()
    found = pads.view_remarks(parameters, parameters.grid())
    # Domes are read beside their plan, but no layer stands for them there.
    assert [remark.blocks for remark in found] == [("color",)] * pads.looks_past_pad(parameters)


@pytest.mark.thorough(cases=("digit-grid0", "flat_pad-grid0"))
@pytest.mark.parametrize("grid", [LYING, UPRIGHT])
@pytest.mark.parametrize("sensor", ["gelsight_mini", "digit", "flat_pad"])
def test_the_check_looks_at_the_pad_that_is_designed(sensor: str, grid: PixelGrid) -> None:
    profile = pads.fitted_design(sensor, grid, {})
    assert pads.fitted_parameters(sensor, grid, {}).pad() == profile_parameters(profile).pad()
    mask = np.ones((grid.height_px, grid.width_px), dtype=bool)
    assert pads.pixels_on_pad(profile, grid, mask) is mask


@pytest.mark.parametrize(
    ("u_px", "scale", "said"),
    [(80, "0.2", "32.0 x 24.0 mm, more than"), (170, "0.1", "its centre has to be inside")],
)
@pytest.mark.parametrize(
    "calibrate", [calibrate_color, calibrate_normals, depth_fit.calibrate_depth]
)
def test_calibrations_refuse_before_they_look_at_a_press(
    calibrate, u_px: float, scale: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = flat_background().round().astype(np.uint8)
    path = write_folder(tmp_path / "c", image, {"p": image}, {"p": ContactCircle(u_px, 60, 15)})
    folder = load_capture_folder(edit_manifest(path, "= 0.1", f"= {scale}"))
    looked: list[object] = []
    for module in (ball_presses, depth_fit):
        monkeypatch.setattr(module, "capture_findings", lambda *_: looked.append(1) or [])
    with pytest.raises(InputError, match=said):
        calibrate(folder, base_profile(None, folder))
    assert not looked


def test_an_image_up_to_the_edge_is_used_without_it() -> None:
    base = catalogue_profile("gelsight")
    wide = replace(synthetic_captures(1)[0], grid=PixelGrid(160, 120, 0.15, 0.15))
    kept = captures_on_pad(wide, base).mask
    inside = pads.inside_mm(profile_parameters(base), wide.grid)
    assert not kept[inside < 0].any() and kept[inside > 1].all() and not kept.all()
