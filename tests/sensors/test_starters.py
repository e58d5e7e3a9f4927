# SPDX-License-Identifier: Apache-2.0
"""Starter profiles: small, marked as another unit's, and usable wherever a sensor is named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.calibration.base_profile import base_profile
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.normals.distilling import with_small_network
from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_toml
from taccel_lab.files.images import read_image
from taccel_lab.networks.normal_settings import ensemble_of
from taccel_lab.reading.reader import Reader
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import sensor_families
from taccel_lab.sensors.starters import ABOUT, NOT_YOUR_UNIT, STARTERS, is_starter
from tests.support.real_data import real_data

NAMES = ["9dtact", "gelsight_mini"]


@pytest.mark.thorough(cases=("9dtact",))
@pytest.mark.parametrize("name", NAMES)
def test_it_is_small_marked_and_licensed(name: str) -> None:
    assert NAMES == sorted(read_toml(ABOUT))
    assert NAMES == sorted(path.name for path in STARTERS.iterdir() if path.is_dir())
    assert set(NAMES) < set(sensor_families())
    assert sum(path.stat().st_size for path in (STARTERS / name).iterdir()) < 360_000
    about = read_toml(ABOUT)[name]
    text = (STARTERS / about["license_text"]).read_text()
    assert about["license"] == "MIT" and about["copyright"] in text
    assert "publish, distribute, sublicense" in text
    profile = tl.load_sensor(name)
    assert is_starter(profile) and NOT_YOUR_UNIT in repr(profile) and about["framing"]
    assert NOT_YOUR_UNIT in profile._repr_html_()
    design = catalogue_profile(name)
    assert not is_starter(design) and design.background is None
    created = {"created": profile.material.provenance.created}
    stamped = design.material.provenance.model_copy(update=created)
    assert profile.material == design.material.model_copy(update={"provenance": stamped})
    assert profile.camera.width_px == design.camera.width_px
    assert profile.camera.height_px == design.camera.height_px
    # A changed design is no stock sensor.
    assert not is_starter(tl.load_sensor(name, thickness_mm=3))


def test_its_mark_survives_saving(tmp_path: Path) -> None:
    tl.save_profile(tl.load_sensor("9dtact"), tmp_path / "profile")
    again = tl.load_sensor(tmp_path / "profile")
    assert is_starter(again) and tl.validate_profile(tmp_path / "profile") == []
    # A calibration does not begin with blocks of another unit.
    cv2.imwrite(str(tmp_path / "background.png"), np.full((240, 320, 3), 120, np.uint8))
    manifest = 'schema_version = 2\nsensor = "gelsight_mini"\nbackground = "background.png"\n'
    (tmp_path / "captures.toml").write_text(manifest)
    base = base_profile(tl.load_sensor("gelsight_mini"), load_capture_folder(tmp_path))
    assert not is_starter(base) and base.color is None and base.background is None


@pytest.mark.thorough(cases=("gelsight_mini",))
@pytest.mark.parametrize("name", NAMES)
def test_an_image_is_read_and_says_whose_profile_it_was(name: str) -> None:
    """A dark or bright blob on the starter's own background is a dent; nothing else is."""
    profile = tl.load_sensor(name)
    assert profile.background_rgb is not None
    untouched = profile.background_rgb
    nothing = tl.read(name, untouched, background=untouched)
    assert np.abs(nothing.depth_m).max() < 0.1e-3
    assert NOT_YOUR_UNIT in repr(nothing)
    assert nothing.figures()["warnings"][0] == NOT_YOUR_UNIT


@pytest.mark.thorough
def test_its_small_network_reads_presses_as_its_ensemble_does() -> None:
    """Depth and force of real presses, to well within what they are uncertain by."""
    both = tl.load_sensor("gelsight_mini")
    assert both.normals is not None and both.normal_weights is not None
    settings = {**both.normals.architecture, "small_hidden": []}
    alone = both.with_block(
        both.normals.replace(architecture=settings), ensemble_of(both.normal_weights)
    )
    readers = Reader(both), Reader(alone)
    for number in (12, 24, 48):
        image = read_image(real_data(f"gsmini_ruihangao_calib/calib_ball/frame_{number}.jpg"))
        top, left = (round(size / 7) for size in image.shape[:2])
        kept = cv2.resize(image[top:-top, left:-left], (320, 240))
        found, wanted = (reader.read(kept) for reader in readers)
        off_mm = abs(found.depth_mm - wanted.depth_mm)
        assert wanted.touch.any and wanted.depth_error_mm is not None
        assert off_mm < 0.1 * wanted.depth_error_mm
        assert found.force_n is not None and wanted.force_n is not None
        assert wanted.force_interval_n is not None
        low, high = wanted.force_interval_n
        assert abs(found.force_n - wanted.force_n) < 0.1 * (high - low) / 4


@pytest.mark.slow
def test_a_profile_without_captures_is_taught_by_its_own_colours() -> None:
    """It still leaves to the ensemble what it is not sure of; colours have to be there."""
    profile = tl.load_sensor("gelsight_mini")
    assert profile.normals is not None and profile.normal_weights is not None
    settings = {**profile.normals.architecture, "small_hidden": []}
    weights = ensemble_of(profile.normal_weights)
    alone = profile.with_block(profile.normals.replace(architecture=settings), weights)
    taught = with_small_network(alone)
    assert taught.normals is not None and taught.normal_weights is not None
    assert taught.normals.architecture["small_hidden"] == [64, 64, 64]
    for name, values in weights.items():
        assert np.array_equal(taught.normal_weights[name], values)
    with pytest.raises(InputError, match="it needs the blocks background, color and normals"):
        with_small_network(alone.without("color"))


@pytest.mark.thorough
def test_a_press_says_so() -> None:
    pressed = tl.press(tl.load_sensor("gelsight_mini"), "sphere:4", depth_mm=0.2, accuracy="fast")
    assert pressed.plan.notes()[0] == NOT_YOUR_UNIT
    assert "colours of a starter profile" in repr(pressed)
    assert pressed.image is not None and pressed.image.shape == (240, 320, 3)
