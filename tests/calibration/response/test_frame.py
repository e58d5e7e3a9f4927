# SPDX-License-Identifier: Apache-2.0
"""Scores of a rendered press, and the light of a frame beside its contact."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.response import frame as response
from taccel_lab.calibration.response.frame import CaptureScene, light_beside
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.light import LightDrift
from tests.support.analytic_surface import analytic_surface
from tests.support.synthetic_presses import GRID, flat_background, known_change


def test_score_separates_disc_crop_and_image() -> None:
    grid, circle = PixelGrid(200, 150, 0.1, 0.1), ContactCircle(100.0, 70.0, 20.0)
    captured = np.full((150, 200, 3), 100.0)
    rendered = captured.copy()
    disc = circle.distance_px(grid) <= 20.0
    rendered[disc] += 6.0
    rendered[0, 0] += 30.0  # outside the crop
    score = response.score_image(rendered, captured, circle, grid)
    assert score.disc_l1 == pytest.approx(6.0)
    assert score.crop_l1 == pytest.approx(6.0 * disc.sum() / 65**2)
    assert score.full_l1 == pytest.approx((6.0 * disc.sum() + 30.0) / disc.size)
    assert score.crop_psnr_db == pytest.approx(10 * np.log10(255**2 / (36.0 * disc.sum() / 65**2)))
    with pytest.raises(InputError, match="differ in shape"):
        response.score_image(rendered[:, 1:], captured, circle, grid)


DRIFT = LightDrift(np.array([1.25, 0.8, 1.0]), np.array([2.0, -3.0, 5.0]))
STILL = flat_background() * np.linspace(0.5, 1.5, GRID.width_px)[None, :, None]
"""A background with a gradient wide enough to tell gain from offset."""
CONTACTS = {
    ContactCircle(70.0, 60.0, 13.0): 0.05,
    ContactCircle(80.0, 59.5, 30.0): 0.1,
    ContactCircle(70.0, 66.0, 40.0): 0.25,
}
"""A tenth, a quarter and a third of the picture's height, and what they leave of a drift."""


def noise_floor_l1(image: np.ndarray, circle: ContactCircle, scene: CaptureScene) -> float:
    surface = analytic_surface(circle, scene.grid, 6.0)
    return response.noise_floor_l1(response.PressFrame("p", image, circle, surface), scene)


@pytest.mark.parametrize("circle", CONTACTS)
def test_drift_is_recovered_beside_a_contact(circle: ContactCircle) -> None:
    rim_mm = circle.radius_px * GRID.mm_per_px_x
    surface = analytic_surface(circle, GRID, 1.25 * rim_mm, decay_mm=0.5 * rim_mm)
    noise = np.random.default_rng(0).normal(0, 0.5, STILL.shape)
    frame = DRIFT.apply(STILL + known_change(surface)) + noise
    scene = CaptureScene(STILL, GRID, 1.0)
    found, wanted = light_beside(frame, scene, circle).apply(STILL), DRIFT.apply(STILL)
    # The gel sinks as far as two radii, which a large contact leaves little beyond.
    assert np.abs(found - wanted).mean() < CONTACTS[circle] * np.abs(wanted - STILL).mean()
    assert DRIFT.remove(DRIFT.apply(frame)) == pytest.approx(frame)
    far = response.beside_pixels(circle, scene)
    v, u = np.nonzero(far)
    beside = np.maximum(np.abs(u - circle.u_px), np.abs(v - circle.v_px))
    assert beside.min() > 1.6 * circle.radius_px  # No crop is reached.
    assert circle.distance_px(GRID)[far].min() > 2 * circle.radius_px


@pytest.mark.thorough(cases=("0.1-size4",))
@pytest.mark.parametrize("size", [(80, 60), (160, 120), (320, 240), (640, 480), (1280, 960)])
@pytest.mark.parametrize("share", [0.1, 0.25, 0.33])
def test_the_same_contact_leaves_enough_at_every_size(size: tuple[int, int], share: float) -> None:
    grid = PixelGrid(*size, 16.0 / size[0], 16.0 / size[0])
    circle = ContactCircle(0.45 * size[0], 0.52 * size[1], share * size[1])
    still = np.full((size[1], size[0], 3), 100.0)
    found = light_beside(still + 5.0, CaptureScene(still, grid, 1.0), circle)
    np.testing.assert_allclose(found.apply(still), still + 5.0, atol=0.1)


def test_a_contact_that_fills_the_picture_leaves_its_light_unknown() -> None:
    circle, scene = ContactCircle(80.0, 59.5, 55.0), CaptureScene(STILL, GRID, 6.0)
    found = light_beside(STILL + 9.0, scene, circle)
    assert found.apply(STILL) == pytest.approx(STILL)
    assert np.sqrt(found.covariance[:, 1, 1]).min() > 9.0
    assert np.isnan(noise_floor_l1(STILL, circle, scene))


def test_noise_floor_ignores_the_contact() -> None:
    grid, circle = PixelGrid(200, 150, 0.1, 0.1), ContactCircle(100.0, 70.0, 20.0)
    still = np.full((150, 200, 3), 100, dtype=np.uint8)
    captured = still + np.uint8(2)
    captured[circle.distance_px(grid) < 36] = 255
    captured[::2] += np.uint8(2) * (captured[::2] < 200)
    found = noise_floor_l1(captured, circle, CaptureScene(still, grid, 2.0))
    assert found == pytest.approx(1.0, abs=0.05)
