# SPDX-License-Identifier: Apache-2.0
"""Depths of a grey sensor are those that a gel can have."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.files.images import read_image
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, press_layer
from taccel_lab.reading.grey import grey_depths, pixel_noise
from taccel_lab.signals.depth_response import DepthMap, DepthResponse
from tests.reading.test_common_gain import darker_corners
from tests.support.real_data import real_data

UNIT = "9dtact_official/shape_reconstruction/calibration/sensor_{}/depth_calibration/rectify_crop_"


def dusty(image: np.ndarray) -> np.ndarray:
    """An image with a speck of eight pixels."""
    found = image.copy()
    cv2.circle(found, (150, 170), 4, (found.mean() - 40.0,) * 3, -1, cv2.LINE_AA)
    return found


def noisy(image: np.ndarray, levels: float) -> np.ndarray:
    return image + np.random.default_rng(1).normal(0.0, levels, image.shape)


def moved(image: np.ndarray) -> np.ndarray:
    """An image a pixel to the right."""
    return np.pad(image, ((0, 0), (1, 0), (0, 0)), "edge")[:, :-1]


CHANGES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "a speck of dust": (dusty, "taken for dirt"),
    "noise of 2 levels": (lambda image: noisy(image, 2.0), ""),
    "noise of 6 levels": (lambda image: noisy(image, 6.0), ""),
    "a pixel to the right": (moved, ""),
    "corners 10 % darker": (lambda image: darker_corners(image, 0.1), "corners and middle"),
    "corners 20 % darker": (lambda image: darker_corners(image, 0.2), "corners and middle"),
    "gamma 0.8": (lambda image: 255.0 * (image / 255.0) ** 0.8, ""),
}


@pytest.mark.parametrize("name", CHANGES)
@pytest.mark.parametrize("unit", [1, 2])
def test_an_untouched_grey_gel_reads_zero(unit: int, name: str) -> None:
    """Before, the speck read 0.13 N (0.04 to 0.34), noise of 6 levels 1 N (0 to 10)."""
    rest = read_image(real_data(UNIT.format(unit) + "ref.png"))
    change, said = CHANGES[name]
    image = np.clip(np.rint(change(rest.astype(float))), 0, 255).astype(np.uint8)
    found = tl.read("9dtact", image, background=rest)
    assert not found.touch.any and found.force_interval_n is not None
    assert found.force_interval_n[0] == 0.0 and found.force_interval_n[1] < 0.2
    assert said in " ".join(found.notes)


@pytest.mark.parametrize("unit", [1, 2])
def test_a_real_press_stays_as_it_is(unit: int) -> None:
    rest, press = (
        read_image(real_data(UNIT.format(unit) + f"{name}.png")) for name in ("ref", "sample")
    )
    found, noisier = (
        tl.read("9dtact", np.clip(np.rint(image), 0, 255).astype(np.uint8), background=rest)
        for image in (press, noisy(press.astype(float), 4.0))
    )
    assert found.depth_mm == pytest.approx(1.83, abs=0.03)
    assert noisier.depth_mm == pytest.approx(found.depth_mm, abs=0.08)
    assert noisier.force_n == pytest.approx(found.force_n, rel=0.1)
    assert all("taken for dirt" not in note for note in (*found.notes, *noisier.notes))


@pytest.mark.parametrize(
    ("tool", "depth_mm"),
    [
        pytest.param(lambda x, y: np.where(np.hypot(x, y) < 0.3, 0.0, FAR_MM), 0.3, id="pin"),
        pytest.param(lambda x, y: np.where(np.abs(x) < 0.2, 0.0, FAR_MM), 0.2, id="blade"),
        pytest.param(lambda x, y: np.hypot(x, y) ** 2 / 1.0, 0.25, id="bead"),
        pytest.param(lambda x, y: 2.0 * np.hypot(x, y), 0.4, id="needle"),
        pytest.param(
            lambda x, y: np.where((np.abs(x) < 2) & (np.abs(y) < 1), 0.0, FAR_MM), 0.3, id="bar"
        ),
    ],
)
def test_no_tool_is_taken_for_dirt(tool, depth_mm: float) -> None:
    """As sharp as they come, by the law of a bonded layer."""
    sensor = tl.load_sensor("9dtact")
    grid, response = sensor.grid(), DepthResponse.from_profile(sensor)
    layer = BondedLayer(sensor.gel.thickness_mm, sensor.material.poisson_ratio)
    x, y = np.meshgrid(grid.x_mm() - grid.x_mm().mean(), grid.y_mm() - grid.y_mm().mean())
    steps = grid.mm_per_px_x, grid.mm_per_px_y
    rise_mm = press_layer(tool(x, y), depth_mm, steps, layer).rise_mm
    assert sensor.background_rgb is not None
    rest = sensor.background_rgb.astype(float)
    image = noisy(response.render(np.maximum(-rise_mm, 0.0), rest), 0.5)
    seen, still = (np.clip(np.rint(i), 0, 255).astype(np.uint8) for i in (image, noisy(rest, 0.3)))
    found = tl.read(sensor, seen, background=still)
    assert found.touch.any and found.depth_mm == pytest.approx(depth_mm, abs=0.06)
    assert all("taken for dirt" not in note for note in found.notes)


@pytest.mark.parametrize("levels", [0.5, 3.0])
def test_noise_of_pixels_is_told_from_what_is_smooth(levels: float) -> None:
    v, u = np.mgrid[:200, :300]
    smooth = 30.0 * np.exp(-((u - 150.0) ** 2 + (v - 90.0) ** 2) / 2000.0) + 0.1 * u
    noise = np.random.default_rng(2).normal(0.0, levels, smooth.shape)
    assert pixel_noise(smooth + noise) == pytest.approx(levels, rel=0.05)


@pytest.mark.parametrize("levels", [6.0, 20.0, 40.0])
def test_noise_that_averaging_leaves_is_as_large_as_stated(levels: float) -> None:
    """Of noise that a window can average none is left to state; of twice as much, twice."""
    sensor = tl.load_sensor("9dtact")
    grid, response = sensor.grid(), DepthResponse.from_profile(sensor)
    assert sensor.background_rgb is not None
    rest = sensor.background_rgb.astype(float)
    x, y = np.meshgrid(grid.x_mm() - grid.x_mm().mean(), grid.y_mm() - grid.y_mm().mean())
    dent_mm = np.maximum(0.6 - (x**2 + y**2) / 8.0, 0.0)
    drawn = response.render(dent_mm, rest)

    def read(noise: float) -> DepthMap:
        image = noisy(drawn, noise)
        return grey_depths(response, image, rest, grid, sensor.gel.thickness_mm).depths

    quiet, found, twice = (read(noise) for noise in (0.0, levels, 2 * levels))
    inside = dent_mm > 0.3
    off, stated = np.abs(found.depth_mm - quiet.depth_mm)[inside], found.reading_sigma_mm[inside]
    assert 0.9 < (off < 2 * stated).mean() <= 1.0
    assert 0.5 < np.sqrt(np.mean(off**2)) / stated.mean() < 1.2
    known, most = (float(each.reading_sigma_mm[inside].mean()) for each in (quiet, twice))
    assert most > 1.4 * stated.mean() or most == pytest.approx(known, rel=0.1)
