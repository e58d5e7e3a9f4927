# SPDX-License-Identifier: Apache-2.0
"""The averaged background: as quiet as the mean, and without what only one frame shows."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.light.average import average_background
from taccel_lab.calibration.light.light import Light
from tests.calibration.contacts.presses import GRID, gel, pressed
from tests.calibration.drawn.faults import add_noise, quantise

STILL = Light(np.ones(3), np.zeros(3))
CONTACT = ContactCircle(45.0, 75.0, 18.0)
OBJECT = ContactCircle(150.0, 60.0, 20.0)


def frames(count: int, rng: np.random.Generator) -> list[np.ndarray]:
    return [quantise(add_noise(pressed(CONTACT), 2.0, rng)) for _ in range(count)]


def averaged(background: np.ndarray, images: list[np.ndarray]) -> np.ndarray:
    count = len(images)
    return average_background(
        background, images, [CONTACT.untouched(GRID)] * count, [STILL] * count
    )


def untouched() -> np.ndarray:
    return CONTACT.distance_px(GRID) > 3.5 * CONTACT.radius_px


@pytest.mark.parametrize("count", [1, 2, 4, 15])
@pytest.mark.parametrize("strength", [0.2, 1.0])
def test_another_object_in_one_frame_stays_out(count: int, strength: float) -> None:
    rng = np.random.default_rng(count)
    background = quantise(add_noise(gel(), 2.0, rng))
    images = frames(count, rng)
    clean = averaged(background, images)
    change = strength * (pressed(OBJECT) - gel())
    images[0] = quantise(np.clip(images[0] + change, 0, 255))
    spoilt = averaged(background, images)
    there = (OBJECT.distance_px(GRID) < 1.2 * OBJECT.radius_px) & untouched()
    # The plain mean has 1 / (count + 1) of the object in it.
    slope = float(np.sum((spoilt - clean)[there] * change[there]) / np.sum(change[there] ** 2))
    assert abs(slope) < 0.2 / (count + 1)


def test_an_object_in_the_background_image_is_outvoted() -> None:
    rng = np.random.default_rng(7)
    images = frames(6, rng)
    change = pressed(OBJECT) - gel()
    result = averaged(quantise(add_noise(gel() + change, 2.0, rng)), images)
    there = (OBJECT.distance_px(GRID) < OBJECT.radius_px) & untouched()
    assert np.abs(result - gel())[there].mean() < 1.0


@pytest.mark.parametrize("count", [1, 3, 7, 31])
def test_noise_is_that_of_the_plain_mean(count: int) -> None:
    rng = np.random.default_rng(count)
    background = quantise(add_noise(gel(), 2.0, rng))
    images = frames(count, rng)
    plain = np.mean([background, *images], axis=0)
    where = untouched()
    gain = np.std((averaged(background, images) - gel())[where]) / np.std((plain - gel())[where])
    # A median's is 1.1 to 1.25 from 4 images on.
    assert 0.99 < gain < 1.03
