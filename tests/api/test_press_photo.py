# SPDX-License-Identifier: Apache-2.0
"""Presses like a photo: place and depth that it shows, and their standard deviations."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.api.press_options import PressOptions
from taccel_lab.api.press_photo import PressPhoto, SeenPress
from taccel_lab.api.press_run import UNREAD, PressRun, like_photo
from taccel_lab.calibration.normals.surface_reading import SurfaceReading, Touch
from taccel_lab.cli.app import main
from taccel_lab.files.atomic_file import write_image
from taccel_lab.geometry import PixelGrid
from taccel_lab.with_error import with_error
from tests.support.commands import refusal

SENSOR = "gelsight_mini"


@pytest.fixture(scope="module")
def photo(tmp_path_factory):
    """A simulated press stands for the photo: its place and depth are known."""
    unit = tl.load_sensor(SENSOR)
    press = tl.press(unit, "sphere:4", depth_mm=0.5, at_mm=(2.0, -1.5), accuracy="fast")
    assert press.image is not None
    path = tmp_path_factory.mktemp("photo") / "photo.png"
    write_image(path, press.image)
    assert unit.background_rgb is not None
    write_image(path.parent / "background.png", unit.background_rgb)
    return path


@pytest.mark.thorough
def test_the_press_in_a_photo_is_found_and_simulated(photo, tmp_path):
    press = tl.press(SENSOR, "sphere:4", like=photo, accuracy="fast")
    like = press.like
    assert like is not None
    np.testing.assert_allclose(like["at_mm"], (2.0, -1.5), atol=0.01)
    assert like["depth_mm"] == pytest.approx(0.5, abs=0.01)
    assert press.plan.options.at_mm == like["at_mm"]
    assert press.plan.options.depth_mm == like["depth_mm"] == press.outcome.path.depth_mm
    assert like["psnr_db"] > like["untouched_psnr_db"] + 15
    assert like["mean_error_levels"] < 0.2 * like["untouched_error_levels"]
    assert "photo" in dict(press.summary()[1])
    assert any("background.png, by its name" in text for text in like["warnings"])
    press.save(tmp_path / "out")
    assert (tmp_path / "out" / "like.png").stat().st_size > 10_000
    written = json.loads((tmp_path / "out" / "press.json").read_text())
    assert written["like"]["psnr_db"] == pytest.approx(like["psnr_db"])
    assert written["at_mm"] == pytest.approx(like["at_mm"])
    assert written["like"]["at_sigma_mm"] == pytest.approx(like["at_sigma_mm"])


@pytest.mark.thorough
def test_the_table_says_what_press_json_does(photo, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["--indenter", "sphere:4", "--like", str(photo), "--accuracy", "fast"]
    assert main(["press", SENSOR, *arguments, "--out", str(out)]) == 0
    said = " ".join("".join(capsys.readouterr()).split())
    like = json.loads((out / "press.json").read_text())["like"]
    for axis, at, sigma in zip("xy", like["at_mm"], like["at_sigma_mm"], strict=True):
        assert f"place in the photo, {axis} {with_error(at, sigma)}" in said
    depth = with_error(like["depth_mm"], like["depth_sigma_mm"])
    assert " +- " in depth and f"depth in the photo {depth}" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tool", "at_mm", "depth_mm"),
    [
        ("sphere:6", (4.0, -3.0), 0.8),
        ("sphere:2", (-3.0, 2.0), 0.2),
        ("cylinder:1.5", (-2.0, 1.5), 0.3),
        ("sphere:3", (6.0, 4.5), 0.4),
    ],
)
def test_presses_are_found_within_their_deviations(tool, at_mm, depth_mm, tmp_path):
    """Of the default accuracy, with the camera's noise; what rough presses miss is in it."""
    unit = tl.load_sensor(SENSOR)
    true = tl.press(unit, tool, depth_mm=depth_mm, at_mm=at_mm)
    assert true.image is not None and unit.background_rgb is not None
    noise = np.random.default_rng(0).standard_normal(true.image.shape)
    noisy = np.clip(np.rint(true.image + noise), 0, 255).astype(np.uint8)
    write_image(tmp_path / "photo.png", noisy)
    write_image(tmp_path / "background.png", unit.background_rgb)
    found = tl.press(unit, tool, like=tmp_path / "photo.png")
    like = found.like
    assert like is not None
    off = np.abs(np.array([*like["at_mm"], like["depth_mm"]]) - [*at_mm, depth_mm])
    assert (off < 0.5 * np.array([*like["at_sigma_mm"], like["depth_sigma_mm"]])).all()
    assert (off < 0.03).all()
    assert found.force_n == pytest.approx(true.force_n, rel=0.03)


# Readings -----------------------------------------------------------------------------------------

GRID = PixelGrid(120, 100, 0.05, 0.05)
RADIUS_MM = 4.0


def reading(
    at_mm: tuple[float, float], depth_mm: float, sigma_mm: float | None, lean: float = 0.0
) -> SurfaceReading:
    """A paraboloid in a gel that rises by ``lean`` along x."""
    x, y = np.meshgrid(GRID.x_mm(), GRID.y_mm())
    away = (x - at_mm[0]) ** 2 + (y - at_mm[1]) ** 2
    dent_mm = np.maximum(depth_mm - away / (2 * RADIUS_MM), 0.0)
    rise_m, rest_m = -1e-3 * dent_mm, 1e-3 * lean * x
    sigma_m = None if sigma_mm is None else np.full(x.shape, 1e-3 * sigma_mm)
    return SurfaceReading(
        height_m=rest_m + rise_m,
        rise_m=rise_m,
        height_sigma_m=None if sigma_m is None else 2 * sigma_m,
        reading_sigma_m=sigma_m,
        normals=np.zeros((*x.shape, 3)),
        sigma_deg=None,
        radius95_deg=None,
        beyond_balls=None,
        saturated=None,
        method="normals",
        touch=Touch(dent_mm > 0.05, 0.05, 0.05),
    )


def test_place_and_depth_of_a_reading():
    found = SeenPress.of(reading((0.6, -0.3), 0.4, None), GRID)
    assert found is not None and found.whole
    np.testing.assert_allclose(found.at_mm, (0.6, -0.3), atol=5e-3)
    assert found.depth_mm == pytest.approx(0.4, abs=1e-3)
    assert found.at_sigma_mm is None and found.depth_sigma_mm is None
    cut = SeenPress.of(reading((2.9, 0.0), 0.4, None), GRID)
    assert cut is not None and not cut.whole
    assert SeenPress.of(reading((0.0, 0.0), 0.04, None), GRID) is None


@pytest.mark.parametrize("sigma_mm", [0.01, 0.02, 0.04])
def test_a_leaning_paraboloid_moves_by_its_radius(sigma_mm):
    """Its lean times its radius: a plane added to ``x^2 / 2R`` moves its vertex by that."""
    found = SeenPress.of(reading((0.0, 0.0), 0.4, sigma_mm), GRID)
    assert found is not None and found.at_sigma_mm is not None
    rim_mm = np.sqrt(RADIUS_MM * 0.4)
    np.testing.assert_allclose(found.at_sigma_mm, RADIUS_MM * sigma_mm / rim_mm, rtol=0.1)
    assert found.depth_sigma_mm == pytest.approx(2 * sigma_mm)


def test_on_a_slope_the_place_is_less_certain_along_it():
    lean = 0.05
    found = SeenPress.of(reading((0.0, 0.0), 0.4, 0.005, lean), GRID)
    level = SeenPress.of(reading((0.0, 0.0), 0.4, 0.005), GRID)
    assert found is not None and found.at_sigma_mm is not None
    assert level is not None and level.at_sigma_mm is not None
    expected = np.hypot(0.5 * lean * RADIUS_MM, level.at_sigma_mm[0])
    assert found.at_sigma_mm[0] == pytest.approx(expected, rel=0.1)
    assert found.at_sigma_mm[1] == pytest.approx(level.at_sigma_mm[1], rel=0.02)


@pytest.mark.thorough
def test_what_the_simulation_cannot_show_is_said(photo):
    """A rough press that leaves no trace in its image corrects nothing."""
    run = PressRun.plan(SENSOR, PressOptions(indenter="sphere:4", like=photo))
    asked: list[PressRun] = []

    def untouched(rough):
        asked.append(rough)
        return SimpleNamespace(image=rough.profile.background_rgb)

    found = like_photo(run, untouched)
    assert found.photo is not None and run.photo is not None
    assert found.photo.warnings == (*run.photo.warnings, UNREAD)
    assert found.options == run.options
    assert [rough.photo for rough in asked] == [None]


@pytest.mark.thorough
def test_a_rough_press_ends_as_the_photo_does(photo):
    """Sideways, but not back to where nothing is seen; its steps are not kept."""
    options = PressOptions(
        indenter="sphere:4", like=photo, shear_mm=(0.2, 0.0), unload=True, states=True
    )
    run = PressRun.plan(SENSOR, options)
    asked: list[PressRun] = []

    def same(rough):
        asked.append(rough)
        assert run.photo is not None
        return SimpleNamespace(image=run.photo.rgb)

    found = like_photo(run, same)
    rough = asked[0].options
    assert (rough.shear_mm, rough.unload, rough.states) == ((0.2, 0.0), False, False)
    assert len(asked) == 1 and found.photo is not None
    assert replace(found.options, at_mm=(0, 0), depth_mm=0) == replace(
        run.options, at_mm=(0, 0), depth_mm=0
    )
    np.testing.assert_allclose(found.options.at_mm, run.options.at_mm, atol=0.01)


# Backgrounds and refusals -------------------------------------------------------------------------


@pytest.mark.thorough
def test_another_background_takes_the_place_of_the_profiles(photo, tmp_path):
    """Of photo and background that are darker alike, nothing else changes."""
    profile = tl.load_sensor(SENSOR)
    assert profile.background_rgb is not None
    untouched = tmp_path / "untouched.png"
    write_image(untouched, profile.background_rgb)

    own, given = (PressPhoto.read(profile, photo, path) for path in (None, untouched))
    np.testing.assert_allclose(own.at_mm, given.at_mm, atol=0.02)
    assert own.depth_mm == pytest.approx(given.depth_mm, abs=0.02)
    moved = own.simulated(profile.background_rgb.astype(np.float64), profile)
    np.testing.assert_array_equal(moved, own.background)


@pytest.mark.thorough
def test_what_shows_no_press_is_refused(photo, tmp_path, capsys):
    profile = tl.load_sensor(SENSOR)
    assert profile.background_rgb is not None
    rest = tmp_path / "rest.png"
    write_image(rest, profile.background_rgb)
    out = tmp_path / "out"
    press = ("press", SENSOR, "--out", out)
    assert "no contact" in refusal(capsys, *press, "--like", rest)
    assert "leave out --depth-mm" in refusal(capsys, *press, "--like", photo, "--depth-mm", 0.5)
    assert "background of --like" in refusal(
        capsys, *press, "--depth-mm", 0.5, "--untouched", photo
    )
    alone = tmp_path / "alone" / "photo.png"
    alone.parent.mkdir()
    shutil.copy(photo, alone)
    assert "is of another unit" in (said := refusal(capsys, *press, "--like", alone))
    assert said.endswith("give an image of your untouched sensor: --untouched")
    assert "no colours" in refusal(capsys, "press", "flat_pad", "--out", out, "--like", photo)
    assert not out.exists()
