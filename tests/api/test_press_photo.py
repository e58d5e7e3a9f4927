# SPDX-License-Identifier: Apache-2.0
"""A press like the one in a photo: found, simulated there, and set beside it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.exporters.image_files import write_rgb
from tests.support.commands import refusal

SENSOR = "gelsight_mini"


@pytest.fixture(scope="module")
def photo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated press stands for the photo: its place and depth are known."""
    unit = tl.load_sensor(SENSOR)
    press = tl.press(unit, "sphere:4", depth_mm=0.5, at_mm=(2.0, -1.5), accuracy="fast")
    assert press.image is not None
    path = tmp_path_factory.mktemp("photo") / "photo.png"
    write_rgb(path, press.image)
    return path


def test_the_press_in_a_photo_is_found_and_simulated(photo: Path, tmp_path: Path) -> None:
    press = tl.press(SENSOR, "sphere:4", like=photo, accuracy="fast")
    like = press.like
    assert like is not None
    np.testing.assert_allclose(like["at_mm"], (2.0, -1.5), atol=0.1)
    assert like["depth_mm"] == pytest.approx(0.5, abs=0.1)
    assert like["psnr_db"] > like["untouched_psnr_db"] + 8
    assert like["mean_error_levels"] < 0.5 * like["untouched_error_levels"]
    assert "photo" in dict(press.summary()[1])
    press.save(tmp_path / "out")
    assert (tmp_path / "out" / "like.png").stat().st_size > 10_000
    written = json.loads((tmp_path / "out" / "press.json").read_text())
    assert written["like"]["psnr_db"] == pytest.approx(like["psnr_db"])


def test_another_background_takes_the_place_of_the_profiles(photo: Path, tmp_path: Path) -> None:
    """Of photo and background that are darker alike, nothing else changes."""
    profile = tl.load_sensor(SENSOR)
    assert profile.background_rgb is not None
    untouched = tmp_path / "untouched.png"
    write_rgb(untouched, profile.background_rgb)
    from taccel_lab.api.press_photo import PressPhoto

    own, given = (PressPhoto.read(profile, photo, path) for path in (None, untouched))
    np.testing.assert_allclose(own.at_mm, given.at_mm, atol=0.02)
    assert own.depth_mm == pytest.approx(given.depth_mm, abs=0.02)
    moved = own.simulated(profile.background_rgb.astype(np.float64), profile)
    np.testing.assert_array_equal(moved, own.background)


def test_what_shows_no_press_is_refused(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    profile = tl.load_sensor(SENSOR)
    assert profile.background_rgb is not None
    rest = tmp_path / "rest.png"
    write_rgb(rest, profile.background_rgb)
    out = tmp_path / "out"
    press = ("press", SENSOR, "--out", out)
    assert "no contact" in refusal(capsys, *press, "--like", rest)
    assert "leave out --depth-mm" in refusal(capsys, *press, "--like", photo, "--depth-mm", 0.5)
    assert "background of --like" in refusal(
        capsys, *press, "--depth-mm", 0.5, "--untouched", photo
    )
    assert "no colours" in refusal(capsys, "press", "flat_pad", "--out", out, "--like", photo)
    assert not out.exists()
