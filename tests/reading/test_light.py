# SPDX-License-Identifier: Apache-2.0
"""Light of single frames and over many, averaged backgrounds, images of another sensor."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from taccel_lab.calibration.light_drift import drift_remarks, drift_spread
from taccel_lab.errors import InputError
from taccel_lab.reading import light as frame_light
from taccel_lab.reading.light import LightDrift, fit_light
from taccel_lab.reading.whose import unlike
from tests.calibration.circles.presses import gel, pressed, scattered
from tests.calibration.drawn.faults import add_gradient, add_noise, drift


def textured(rng: np.random.Generator) -> np.ndarray:
    """A gel with shades of its own: they tell gain from gradient."""
    shades = gaussian_filter(rng.normal(0, 1, gel().shape), (8, 8, 0))
    return gel() + 15 * shades / shades.std()


@pytest.mark.thorough
@settings(max_examples=5, deadline=None)
@given(
    gain=st.tuples(*[st.floats(0.7, 1.3)] * 3), offset=st.tuples(*[st.floats(-20, 20)] * 3),
    tilt=st.tuples(st.floats(-6, 6), st.floats(-6, 6)), seed=st.integers(0, 20),
)  # fmt: skip
def test_drift_is_found_although_a_ball_presses(
    gain: tuple[float, ...], offset: tuple[float, ...], tilt: tuple[float, float], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rough = textured(rng)

    def lit(image: np.ndarray) -> np.ndarray:
        return add_gradient(drift(image, np.array(gain), np.array(offset)), *tilt)

    image = lit(rough + pressed(scattered(1, seed)[0]) - gel())
    found = fit_light(add_noise(image, 0.5, rng), rough)
    assert found.gain == pytest.approx(gain, abs=0.04)
    shown = found.apply(rough)
    assert np.abs(shown - lit(rough)).mean() < 0.8
    assert found.remove(shown) == pytest.approx(rough, abs=1e-6)


def test_perfect_drift_is_exact() -> None:
    rough = textured(np.random.default_rng(0))
    found = fit_light(drift(rough, np.array([0.7, 1.1, 1.0]), 5.0), rough)
    assert found.gain == pytest.approx([0.7, 1.1, 1.0], abs=5e-3)
    assert found.noise_levels < 0.4
    assert found.remove(found.apply(rough)) == pytest.approx(rough, abs=1e-6)
    tilted = LightDrift(np.ones(3), np.zeros(3), np.ones((3, 2)))
    with pytest.raises(InputError, match="whole image"):
        tilted.remove(np.zeros((10, 3)))


@pytest.mark.parametrize("sigma", [0.07, 0.2, 1.0, 10.0])
@pytest.mark.parametrize("shade", [0.0, 3.0])
def test_a_wider_prior(sigma: float, shade: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A background without shades of its own tells no gain, however little is known before."""
    monkeypatch.setattr(frame_light, "PRIOR_SIGMA", frame_light.PRIOR_SIGMA * sigma / 0.07)
    rng = np.random.default_rng(2)
    # The slope over the image is what a gradient explains as well.
    flat = add_gradient(np.full((150, 200, 3), 120.0), shade, 0.0)
    noise = gaussian_filter(rng.normal(0, 1, (2, *flat.shape)), (0, 2, 2, 0))
    noise *= 2.0 / noise.std()
    found = fit_light(flat + noise[0] + 6.0, flat + noise[1])
    assert found.gain == pytest.approx([1.0] * 3, abs=0.1)
    assert np.abs(found.apply(flat) - flat - 6.0).mean() < 0.5


def test_auto_white_balance_is_told_from_lamps_that_warm_up() -> None:
    rng, zero = np.random.default_rng(8), np.zeros(3)
    balance = [LightDrift(1 + rng.normal(0, 0.05, 3), zero) for _ in range(20)]
    warming = [LightDrift(np.full(3, 1 + 0.1 * k / 20), zero) for k in range(20)]
    steady = [LightDrift(1 + rng.normal(0, 0.002, 3), zero) for _ in range(20)]
    assert drift_spread(balance, gel()).auto_white_balance
    assert not drift_spread(warming, gel()).auto_white_balance
    (apart,), (warmed,) = drift_remarks(balance, gel()), drift_remarks(warming, gel())
    assert "white balance off" in apart.message and "warm up" in warmed.message
    assert drift_remarks(steady, gel()) == []


V, U = np.mgrid[-1:1:60j, -1:1:80j]
BACKGROUND = np.stack([110 + 35 * U, 120 + 30 * V, 130 - 25 * U - 20 * V], -1).astype(np.float32)


def say(image: np.ndarray, mask: np.ndarray | None = None) -> str | None:
    image = image.astype(np.float32)
    return unlike(image, BACKGROUND, fit_light(image, BACKGROUND, mask, gradient=False), mask)


def ball_pressed(u: float, v: float, radius: float) -> np.ndarray:
    """The background with a ball's colours in a disc."""
    inside = np.hypot(U - u, V - v) < radius
    change = np.stack([60 * (U - u), 60 * (V - v), -60 * (U - u)], axis=-1) / radius
    return np.clip(BACKGROUND + np.where(inside[..., None], change, 0.0), 0, 255)


@given(
    u=st.floats(-0.9, 0.9), v=st.floats(-0.9, 0.9), radius=st.floats(0.1, 0.6),
    gain=st.floats(0.8, 1.25), offset=st.floats(-10, 10),
)  # fmt: skip
def test_a_press_is_of_its_sensor(u, v, radius, gain, offset) -> None:
    assert say(gain * ball_pressed(u, v, radius) + offset) is None


@pytest.mark.parametrize(
    ("image", "why"),
    [
        (np.zeros_like(BACKGROUND), "one colour"),
        (np.full_like(BACKGROUND, 255.0), "one colour"),
        (np.random.default_rng(0).integers(0, 256, BACKGROUND.shape), "differ|its light"),
        (BACKGROUND[..., ::-1], "red and blue"),
        (ball_pressed(0.2, 0.1, 0.4)[..., ::-1], "red and blue"),
        (BACKGROUND[::-1, ::-1], "180 degrees"),
        (BACKGROUND[:, ::-1], "left to right"),
        (BACKGROUND[::-1], "top to bottom"),
        (0.1 * BACKGROUND + 100, "its light"),
    ],
    ids=["black", "white", "noise", "bgr", "bgr press", "turned", "left", "top", "pale"],
)
def test_what_is_not_is_named(image: np.ndarray, why: str) -> None:
    found = say(image)
    assert found is not None and any(word in found for word in why.split("|")), found


def test_masked_pixels_do_not_count() -> None:
    mask = np.broadcast_to(np.arange(80) >= 64, (60, 80))
    assert say(np.where(mask[..., None], BACKGROUND, 0.0), mask) is None


def test_lights_on_one_another_go_off_at_once_in_single_precision() -> None:
    rng = np.random.default_rng(4)
    image = rng.uniform(0, 255, (7, 9, 3)).astype(np.float32)
    own, day = (
        LightDrift(1 + 0.2 * rng.random(3), 9 * rng.random(3), 9 * rng.random((3, 2)))
        for _ in range(2)
    )
    expected = day.remove(own.remove(image))
    assert own.on(day).remove(image) == pytest.approx(expected, rel=1e-12, abs=1e-10)
    for light in (own.on(day), LightDrift(own.gain, own.offset)):
        found = light.removed(image)
        assert found.dtype == np.float32
        assert found == pytest.approx(light.remove(image), abs=1e-3)


@pytest.mark.parametrize("width", [640, 427, 90])
def test_a_gradient_is_that_over_the_whole_image(width: int) -> None:
    """It is fitted to means over blocks, of which the outer ones end within the image."""
    rng = np.random.default_rng(5)
    known = gaussian_filter(rng.normal(0, 1, (width * 3 // 4, width, 3)), (9, 9, 0))
    known = 120 + 20 * known / known.std()
    u, v = np.linspace(-1, 1, width), np.linspace(-1, 1, len(known))
    plane = u[None, :, None] * [9.0, -6.0, 3.0] + v[:, None, None] * [-4.0, 8.0, 0.0]
    found = fit_light(known + plane + rng.normal(0, 1, known.shape), known)
    assert found.gradient == pytest.approx(np.array([[9, -4], [-6, 8], [3, 0]]), abs=0.12)


def test_light_goes_on_and_off_by_its_formula_to_the_bit():
    """Whole images are worked on by rows of all channels, lists of pixels as they are."""
    rng = np.random.default_rng(3)
    image = rng.uniform(0, 255, (7, 9, 3)).astype(np.float32)
    gain, offset, gradient = 1 + 0.1 * rng.random(3), rng.random(3), rng.random((3, 2))
    light = LightDrift(gain, offset, gradient)
    u, v = np.linspace(-1, 1, 9)[None, :, None], np.linspace(-1, 1, 7)[:, None, None]
    plane = u * gradient[:, 0] + v * gradient[:, 1]
    assert np.array_equal(light.remove(image), (image - offset - plane) / gain)
    assert np.array_equal(light.apply(image), image * gain + offset + plane)
    pixels = image.reshape(-1, 3)
    there = light.at(np.arange(63), 7, 9).remove(pixels)
    assert np.allclose(there, light.remove(image).reshape(-1, 3), rtol=1e-12)
