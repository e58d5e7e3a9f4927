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
from taccel_lab.files.documents import read_toml
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import sensor_families
from taccel_lab.sensors.starters import ABOUT, NOT_YOUR_UNIT, STARTERS, is_starter

NAMES = ["9dtact", "gelsight_mini"]


@pytest.mark.thorough(cases=("9dtact",))
@pytest.mark.parametrize("name", NAMES)
def test_it_is_small_marked_and_licensed(name: str) -> None:
    assert NAMES == sorted(read_toml(ABOUT))
    assert NAMES == sorted(path.name for path in STARTERS.iterdir() if path.is_dir())
    assert set(NAMES) < set(sensor_families())
    assert sum(path.stat().st_size for path in (STARTERS / name).iterdir()) < 320_000
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
def test_a_press_says_so() -> None:
    pressed = tl.press(tl.load_sensor("gelsight_mini"), "sphere:4", depth_mm=0.2, accuracy="fast")
    assert pressed.plan.notes()[0] == NOT_YOUR_UNIT
    assert "colours of a starter profile" in repr(pressed)
    assert pressed.image is not None and pressed.image.shape == (240, 320, 3)
