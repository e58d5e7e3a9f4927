# SPDX-License-Identifier: Apache-2.0
"""Images that are not of the background's sensor are named; presses and other light are not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.calibration.light.fit import fit_light
from taccel_lab.calibration.light.likeness import unlike

HEIGHT, WIDTH = 60, 80
V, U = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j]
BACKGROUND = np.stack([110 + 35 * U, 120 + 30 * V, 130 - 25 * U - 20 * V], axis=-1).astype(
    np.float32
)


def say(image: np.ndarray, background: np.ndarray = BACKGROUND) -> str | None:
    image = image.astype(np.float32)
    return unlike(image, background, fit_light(image, background, gradient=False))


def pressed(u: float, v: float, radius: float) -> np.ndarray:
    """The background with a ball's colours in a disc."""
    inside = np.hypot(U - u, V - v) < radius
    change = np.stack([60 * (U - u), 60 * (V - v), -60 * (U - u)], axis=-1) / radius
    return np.clip(BACKGROUND + np.where(inside[..., None], change, 0.0), 0, 255)


@given(
    u=st.floats(-0.9, 0.9),
    v=st.floats(-0.9, 0.9),
    radius=st.floats(0.1, 0.6),
    gain=st.floats(0.8, 1.25),
    offset=st.floats(-10, 10),
)
def test_a_press_is_of_its_sensor(u, v, radius, gain, offset) -> None:
    assert say(gain * pressed(u, v, radius) + offset) is None


@pytest.mark.parametrize(
    ("image", "why"),
    [
        (np.zeros_like(BACKGROUND), "one colour"),
        (np.full_like(BACKGROUND, 255.0), "one colour"),
        (np.random.default_rng(0).integers(0, 256, BACKGROUND.shape), "differ|its light"),
        (BACKGROUND[..., ::-1], "red and blue"),
        (pressed(0.2, 0.1, 0.4)[..., ::-1], "red and blue"),
        (BACKGROUND[::-1, ::-1], "180 degrees"),
        (BACKGROUND[:, ::-1], "left to right"),
        (BACKGROUND[::-1], "top to bottom"),
        (0.1 * BACKGROUND + 100, "its light"),
    ],
    ids=["black", "white", "noise", "bgr", "bgr press", "turned", "left", "top", "pale"],
)
def test_what_is_not_is_named(image: np.ndarray, why: str) -> None:
    found = say(image)
    assert found is not None
    assert any(word in found for word in why.split("|")), found


def test_masked_pixels_do_not_count() -> None:
    image = BACKGROUND.copy()
    image[:, : int(0.8 * WIDTH)] = 0.0
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:, int(0.8 * WIDTH) :] = True
    light = fit_light(image, BACKGROUND, mask, gradient=False)
    assert unlike(image, BACKGROUND, light, mask) is None
