# SPDX-License-Identifier: Apache-2.0
"""Presses like a photo: place and depth that it shows, and their standard deviations."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.api.press import photo_reader, planned_press
from taccel_lab.files.atomic_file import write_image
from taccel_lab.files.images import read_image
from taccel_lab.geometry import PixelGrid
from taccel_lab.presses.options import PressOptions
from taccel_lab.presses.photo import PressPhoto, SeenPress
from taccel_lab.presses.run import UNREAD, PressRun, like_photo
from taccel_lab.reading.directions import Directions
from taccel_lab.reading.reading import Reading
from taccel_lab.reading.touch import Touch
from taccel_lab.report.page import PAGE
from taccel_lab.with_error import with_error
from tests.signals.pressed_surface import pixel_xy
from tests.support.commands import done, refusal
from tests.support.oblong_grey import GRID as OBLONG
from tests.support.oblong_grey import grey_profile

SENSOR = "gelsight_mini"


@pytest.fixture(scope="module")
def unit():
    return tl.load_sensor(SENSOR)


@pytest.fixture(scope="module")
def photo(unit, tmp_path_factory):
    """A simulated press stands for the photo: its place and depth are known."""
    press = tl.press(unit, "sphere:4", depth_mm=0.5, at_mm=(2.0, -1.5), accuracy="fast")
    path = tmp_path_factory.mktemp("photo") / "photo.png"
    write_image(path, press.image)
    write_image(path.parent / "background.png", unit.background_rgb)
    return path


@pytest.mark.thorough
def test_the_press_in_a_photo_is_found_and_simulated(photo, tmp_path, capsys, monkeypatch):
    made, run = [], PressRun.run
    monkeypatch.setattr(PressRun, "run", lambda *given: made.append(run(*given)) or made[-1])
    words = ["--indenter", "sphere:4", "--like", photo, "--accuracy", "fast"]
    found = done(capsys, "press", SENSOR, *words, "--out", tmp_path / "out")
    press = made[-1]  # After the rough one.
    like = press.like
    np.testing.assert_allclose(like["at_mm"], (2.0, -1.5), atol=0.01)
    assert like["depth_mm"] == pytest.approx(0.5, abs=0.01)
    assert press.plan.options.at_mm == like["at_mm"]
    assert press.plan.options.depth_mm == like["depth_mm"] == press.path.depth_mm
    assert like["psnr_db"] > like["untouched_psnr_db"] + 15
    assert like["mean_error_levels"] < 0.2 * like["untouched_error_levels"]
    assert "photo" in dict(press.summary()[1])
    assert any("background.png, by its name" in text for text in like["warnings"])
    assert (tmp_path / "out" / "like.png").stat().st_size > 10_000
    written = json.loads((tmp_path / "out" / "press.json").read_text())
    assert written["at_mm"] == pytest.approx(like["at_mm"])
    for name in ("psnr_db", "at_error_mm"):
        assert written["like"][name] == pytest.approx(like[name])
    # The table says what press.json does.
    said = " ".join((found.out + found.err).split())
    like = written["like"]
    for axis, at, sigma in zip("xy", like["at_mm"], like["at_error_mm"], strict=True):
        assert f"place in the photo, {axis} {with_error(at, sigma)}" in said
    depth = with_error(like["depth_mm"], like["depth_error_mm"])
    assert " +- " in depth and f"depth in the photo {depth}" in said
    # One depth of the press: what the photo alone reads stands beside it without a number.
    page = unescape((tmp_path / "out" / PAGE).read_text(encoding="utf-8"))
    assert f"{depth} mm deep" in page.replace(" ± ", " +- ")
    assert not re.search(r"depth read from the photo\W+\d", page)


@pytest.mark.thorough
@pytest.mark.parametrize(("gain", "least", "most"), [(1.0, 0.02, 0.05), (1.2, 0.06, 0.12)])
def test_a_depth_is_as_uncertain_as_closing_the_loop_left_it(
    gain, least, most, photo, unit, tmp_path
):
    """A photo like the simulation was right to 0.001 mm at a deviation of 0.12 mm, that of one
    reading; one with colours that are 20 % stronger shows around the press that it is off."""
    unit.save(tmp_path / "own")
    text = (tmp_path / "own/profile.toml").read_text()
    # A starter's readings are off by what units differ by, which nothing shows.
    assert "unit_share = 0.25" in text
    (tmp_path / "own/profile.toml").write_text(
        text.replace("unit_share = 0.25", "unit_share = 0.0")
    )
    rest = unit.background_rgb.astype(np.float64)
    rgb = np.clip(np.rint(rest + gain * (read_image(photo) - rest)), 0, 255).astype(np.uint8)
    write_image(tmp_path / "photo.png", rgb)
    found = tl.press(
        tmp_path / "own",
        "sphere:4",
        like=tmp_path / "photo.png",
        untouched=photo.parent / "background.png",
        accuracy="fast",
    )
    sigma_mm = found.like["depth_error_mm"]
    assert least < sigma_mm < most < found.plan.photo.seen.depth_error_mm
    assert abs(found.like["depth_mm"] - 0.5) < 2 * sigma_mm
    depth = next(each for each in found.force_interval.causes if each.name == "depth")
    assert depth.high / depth.low < 3.0


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
def test_presses_are_found_within_their_deviations(tool, at_mm, depth_mm, unit, tmp_path):
    """Of the default accuracy, with the camera's noise; what rough presses miss is in it."""
    true = tl.press(unit, tool, depth_mm=depth_mm, at_mm=at_mm)
    noise = np.random.default_rng(0).standard_normal(true.image.shape)
    noisy = np.clip(np.rint(true.image + noise), 0, 255).astype(np.uint8)
    write_image(tmp_path / "photo.png", noisy)
    write_image(tmp_path / "background.png", unit.background_rgb)
    found = tl.press(unit, tool, like=tmp_path / "photo.png")
    like = found.like
    off = np.abs(np.array([*like["at_mm"], like["depth_mm"]]) - [*at_mm, depth_mm])
    assert (off < 0.5 * np.array([*like["at_error_mm"], like["depth_error_mm"]])).all()
    assert (off < 0.03).all()
    assert found.force_n == pytest.approx(true.force_n, rel=0.03)


GRID = PixelGrid(120, 100, 0.05, 0.06, center_v_px=44.0)
RADIUS_MM = 4.0


def seen(
    at_mm: tuple[float, float] = (0.0, 0.0), depth_mm: float = 0.4, sigma_mm: float | None = None,
    lean: float = 0.0,
) -> SeenPress | None:  # fmt: skip
    """A paraboloid in a gel that rises by ``lean`` along x."""
    x, y = pixel_xy(GRID)
    away_mm2 = 1e6 * ((x - 1e-3 * at_mm[0]) ** 2 + (y - 1e-3 * at_mm[1]) ** 2)
    dent_mm = np.maximum(depth_mm - away_mm2 / (2 * RADIUS_MM), 0.0)
    sigma_m = None if sigma_mm is None else np.full(x.shape, 1e-3 * sigma_mm)
    reading = Reading(
        grid=GRID,
        image=np.zeros((*x.shape, 3)),
        height_m=lean * x - 1e-3 * dent_mm,
        depth_m=1e-3 * dent_mm,
        height_sigma_m=None if sigma_m is None else 2 * sigma_m,
        reading_sigma_m=sigma_m,
        directions=lambda: Directions(np.zeros((*x.shape, 3))),
        saturated=None,
        method="normals",
        touch=Touch(dent_mm > 0.05, 0.05, 0.05),
    )
    return SeenPress.of(reading)


def test_place_and_depth_of_a_reading():
    found = seen((0.6, -0.3))
    assert found.whole and not seen((2.9, 0.0)).whole
    np.testing.assert_allclose(found.at_mm, (0.6, -0.3), atol=5e-3)
    assert found.depth_mm == pytest.approx(0.4, abs=1e-3)
    assert found.at_error_mm is None and found.depth_error_mm is None
    assert seen(depth_mm=0.04) is None


@pytest.mark.parametrize("sigma_mm", [0.01, 0.02, 0.04])
def test_a_leaning_paraboloid_moves_by_its_radius(sigma_mm):
    """Its lean times its radius: a plane added to ``x^2 / 2R`` moves its vertex by that."""
    found = seen(sigma_mm=sigma_mm)
    rim_mm = np.sqrt(RADIUS_MM * 0.4)
    np.testing.assert_allclose(found.at_error_mm, RADIUS_MM * sigma_mm / rim_mm, rtol=0.1)
    assert found.depth_error_mm == pytest.approx(2 * sigma_mm)


def test_on_a_slope_the_place_is_less_certain_along_it():
    lean = 0.05
    found, level = (seen(sigma_mm=0.005, lean=by).at_error_mm for by in (lean, 0.0))
    assert found[0] == pytest.approx(np.hypot(0.5 * lean * RADIUS_MM, level[0]), rel=0.1)
    assert found[1] == pytest.approx(level[1], rel=0.02)


def test_a_photo_is_compared_within_a_square_around_the_contact():
    """Of 1.6 radii to each side; photo and simulation differ beside it, the untouched inside."""
    profile = grey_profile()
    x, y = np.meshgrid(OBLONG.x_mm() - 0.4, OBLONG.y_mm() + 0.5)
    beside = np.maximum(np.abs(x), np.abs(y)) > 1.6 * 1.5 + 0.2
    inner = np.maximum(np.abs(x), np.abs(y)) < 1.6 * 1.5 - 0.2
    rest = profile.background_rgb.astype(np.float64)
    rgb, painted = rest + 40.0 * (inner | beside)[..., None], rest + 40.0 * inner[..., None]
    found = PressPhoto(
        Path("photo.png"), rgb, (0.4, -0.5), 0.5, None, None, (), None, None,
        SimpleNamespace(background=rest),
    )  # fmt: skip
    figures = found.figures(painted, x**2 + y**2 < 1.5**2, profile)
    assert figures["mean_error_levels"] == 0.0 and figures["untouched_error_levels"] > 28.0


def corrected(run: PressRun, rgb: np.ndarray) -> tuple[PressRun, list[PressRun]]:
    """The press as it is corrected by a rough one that looks like this, and the rough ones."""
    asked = []

    def rough_press(rough):
        asked.append(rough)
        return SimpleNamespace(image=rgb)

    return like_photo(run, rough_press), asked


@pytest.mark.thorough
def test_what_the_simulation_cannot_show_is_said(photo, unit):
    """A rough press that leaves no trace in its image corrects nothing."""
    run = planned_press(SENSOR, PressOptions(indenter="sphere:4", like=photo))
    found, asked = corrected(run, unit.background_rgb)
    assert found.photo.warnings == (*run.photo.warnings, UNREAD)
    assert found.options == run.options
    assert [rough.photo for rough in asked] == [None]


@pytest.mark.thorough
def test_a_rough_press_ends_as_the_photo_does(photo):
    """Sideways, but not back to where nothing is seen; its steps are not kept."""
    back = {"shear_mm": (0.2, 0.0), "unload": True, "states": True}
    run = planned_press(SENSOR, PressOptions(indenter="sphere:4", like=photo, **back))
    found, (rough,) = corrected(run, run.photo.rgb)
    assert (rough.options.shear_mm, rough.options.unload) == ((0.2, 0.0), False)
    assert not rough.options.states and found.photo is not None
    one, other = (replace(each.options, at_mm=(0, 0), depth_mm=0) for each in (found, run))
    assert one == other
    np.testing.assert_allclose(found.options.at_mm, run.options.at_mm, atol=0.01)


@pytest.mark.thorough
def test_another_background_takes_the_place_of_the_profiles(photo, unit, tmp_path):
    """Of photo and background that are darker alike, nothing else changes."""
    write_image(tmp_path / "untouched.png", unit.background_rgb)
    own, given = (
        PressPhoto.read(unit, photo, path, photo_reader)
        for path in (None, tmp_path / "untouched.png")
    )
    np.testing.assert_allclose(own.at_mm, given.at_mm, atol=0.02)
    assert own.depth_mm == pytest.approx(given.depth_mm, abs=0.02)
    moved = own.simulated(unit.background_rgb.astype(np.float64), unit)
    np.testing.assert_array_equal(moved, own.background)


@pytest.mark.thorough
def test_what_shows_no_press_is_refused(photo, unit, tmp_path, capsys):
    rest, alone = tmp_path / "rest.png", tmp_path / "alone" / "photo.png"
    write_image(rest, unit.background_rgb)
    alone.parent.mkdir()
    shutil.copy(photo, alone)
    for words, said in (
        ((SENSOR, "--like", rest), "no contact"),
        ((SENSOR, "--like", photo, "--depth-mm", 0.5), "leave out --depth-mm"),
        ((SENSOR, "--depth-mm", 0.5, "--untouched", photo), "background of --like"),
        ((SENSOR, "--like", alone), "is of another unit"),
        ((SENSOR, "--like", alone), "give an image of your untouched sensor: --untouched"),
        (("flat_pad", "--like", photo), "no colours"),
    ):
        assert said in refusal(capsys, "press", *words, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
