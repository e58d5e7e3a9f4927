# SPDX-License-Identifier: Apache-2.0
"""Dots on a gel: which pixels they cover, and that a touch reads as without them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from taccel_lab.files.images import read_image
from taccel_lab.reading.dots import dot_mask
from taccel_lab.reading.dots.dot_mask import DotMask, painted_over
from taccel_lab.reading.reader import Reader
from taccel_lab.sensors.profile import stock_sensor
from tests.calibration.drawn.dots import HEIGHT, WIDTH, draw_dots, grid_points, picture
from tests.calibration.drawn.faults import quantise, vignette
from tests.support.real_data import real_data

GRID = grid_points()


def dotted(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """An image, RGB levels, with dots that take nine tenths of its light."""
    return quantise(image * draw_dots(WIDTH, HEIGHT, points, 5.5, 1.0, 0.1)[..., None])


@pytest.mark.thorough
@pytest.mark.parametrize("number", [16, 22])
def test_a_real_press_reads_under_dots_as_without_them(number: int) -> None:
    """Dots are drawn over a ball's press, and go along with it: they change heights by less than a
    twelfth of their deviation, depth, area and force by some hundredths."""
    photo = read_image(real_data(f"gsmini_ruihangao_calib/calib_ball/frame_{number}.jpg"))
    top, left = (round(count / 7) for count in photo.shape[:2])
    press = cv2.resize(photo[top:-top, left:-left], (WIDTH, HEIGHT))
    profile = stock_sensor("gelsight_mini")
    assert profile.background_rgb is not None
    rest = profile.background_rgb
    whole = Reader(profile, background=rest).read(press)
    found = Reader(profile, background=dotted(rest, GRID)).read(dotted(press, GRID + (3.0, -2.0)))
    assert whole.height_sigma_m is not None and found.height_sigma_m is not None
    off = (found.height_m - whole.height_m) / whole.height_sigma_m
    assert np.sqrt(np.square(off).mean()) < 0.08
    assert np.median(found.height_sigma_m / whole.height_sigma_m) == pytest.approx(1.0, abs=0.03)
    assert found.depth_mm == pytest.approx(whole.depth_mm, rel=0.02)
    assert found.area_mm2 == pytest.approx(whole.area_mm2, rel=0.04)
    assert found.force_n == pytest.approx(whole.force_n, rel=0.02)


def test_what_changes_evenly_goes_on_under_dots() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    even = np.stack([0.3 * u - 0.1 * v, 40 + 0.2 * v, 0 * u], axis=-1)
    free = draw_dots(WIDTH, HEIGHT, GRID, 7.0, 1.0, 0.0) > 0.5
    found = painted_over(np.where(free[..., None], even, np.float32(np.inf)), free)
    np.testing.assert_array_equal(found[free], even[free])
    assert np.abs(found - even).max() < 0.3


def test_dots_that_go_along_with_the_gel_stay_covered() -> None:
    """The light around them is found on a picture made small for it."""
    rng = np.random.default_rng(2)
    light = vignette(np.full((HEIGHT, WIDTH, 3), 160.0), 0.4)

    def gel(points: np.ndarray) -> np.ndarray:
        shown = draw_dots(WIDTH, HEIGHT, points, 3.5) / 160.0
        return (light * shown[..., None] + rng.normal(0, 1.5, light.shape)).astype(np.float32)

    mask = DotMask.of(gel(GRID))
    assert mask is not None
    moved = GRID + (3.0, -2.0)
    free = ~mask.covered(gel(moved))
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    for points in (GRID, moved):
        to_dot = np.hypot(u[..., None] - points[:, 0], v[..., None] - points[:, 1]).min(axis=-1)
        assert not free[to_dot <= 4.0].any()
    assert free.mean() > 0.55


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_turned_picture_has_turned_dots(turns: int) -> None:
    rng = np.random.default_rng(4)
    rest, press = (
        np.repeat(picture(GRID + way, 5.5, noise=1.0)[..., None], 3, axis=-1).astype(np.float32)
        for way in (0.0, 4.0)
    )
    change = rng.normal(0.0, 9.0, rest.shape).astype(np.float32)
    straight, turned = DotMask.of(rest), DotMask.of(np.rot90(rest, turns))
    assert straight is not None and turned is not None
    covered, also = straight.covered(press), turned.covered(np.rot90(press, turns))
    np.testing.assert_array_equal(also, np.rot90(covered, turns))
    found = painted_over(np.rot90(change, turns), ~also)
    assert np.abs(found - np.rot90(painted_over(change, ~covered), turns)).max() < 1e-4


def test_dirt_is_not_searched_for_a_lattice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spots that stand anyhow are none: a search among them takes seconds."""
    rng = np.random.default_rng(3)
    spots = rng.uniform((10, 10), (WIDTH - 10, HEIGHT - 10), (30, 2))
    image = np.repeat(draw_dots(WIDTH, HEIGHT, spots, 3.0)[..., None], 3, axis=-1)
    monkeypatch.setattr(dot_mask, "markers_or_none", None)
    assert DotMask.of(image.astype(np.float32)) is None
