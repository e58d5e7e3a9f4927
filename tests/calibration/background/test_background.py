# SPDX-License-Identifier: Apache-2.0
"""Drift of single frames, backgrounds of many, noise, dust and stains."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, uniform_filter

from taccel_lab.calibration.background.dust import dust_mask, speck_count
from taccel_lab.calibration.background.fit import calibrate_background
from taccel_lab.calibration.capture import ContactCircle, Press
from taccel_lab.calibration.capture.folder import CaptureFolder, Frame
from taccel_lab.calibration.light.drift import drift_remark, drift_spread
from taccel_lab.calibration.light.fit import PRIOR_SIGMA, fit_light, normal_equations
from taccel_lab.calibration.light.light import Light
from taccel_lab.calibration.synthetic import (
    add_dust,
    add_gradient,
    add_noise,
    drift,
    poison,
    quantise,
)
from taccel_lab.errors import InputError
from tests.calibration.contacts.presses import BALL_MM, GRID, gel, pressed, scattered
from tests.calibration.synthetic import tiny_profile


def frame(name: str, image: np.ndarray) -> Frame:
    return Frame(name, name, "0" * 64, partial(np.copy, image))


def capture_folder(
    background: np.ndarray | None,
    untouched: list[np.ndarray],
    presses: list[np.ndarray],
    mask: np.ndarray | None = None,
) -> CaptureFolder:
    return CaptureFolder(
        source="memory",
        root=Path(),
        sensor="gelsight",
        unit=None,
        background=None if background is None else frame("background", background),
        untouched=tuple(frame(f"u{i}", image) for i, image in enumerate(untouched)),
        mask=mask,
        mm_per_px=(GRID.mm_per_px_x, GRID.mm_per_px_y),
        ball_radius_mm=BALL_MM,
        presses=tuple(
            Press(f"p{i}", f"p{i}", "1" * 64, None, partial(np.copy, image))
            for i, image in enumerate(presses)
        ),
    )


def textured(rng: np.random.Generator) -> np.ndarray:
    """A gel with shades of its own: they tell gain from gradient."""
    shades = gaussian_filter(rng.normal(0, 1, gel().shape), (8, 8, 0))
    return gel() + 15 * shades / shades.std()


@settings(max_examples=10, deadline=None)
@given(
    gain=st.tuples(*[st.floats(0.7, 1.3)] * 3), offset=st.tuples(*[st.floats(-20, 20)] * 3),
    tilt=st.tuples(st.floats(-6, 6), st.floats(-6, 6)), seed=st.integers(0, 20),
)  # fmt: skip
def test_drift_is_found_although_a_ball_presses(
    gain: tuple[float, ...], offset: tuple[float, ...], tilt: tuple[float, float], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rough = textured(rng)
    image = rough + pressed(scattered(1, seed)[0]) - gel()
    image = add_gradient(drift(image, np.array(gain), np.array(offset)), *tilt)
    found = fit_light(add_noise(image, 0.5, rng), rough)
    assert found.gain == pytest.approx(gain, abs=0.04)
    shown = found.apply(rough)
    wanted = add_gradient(drift(rough, np.array(gain), np.array(offset)), *tilt)
    assert np.abs(shown - wanted).mean() < 0.8
    back = found.remove(shown)
    assert back == pytest.approx(rough, abs=1e-6)


def test_perfect_drift_is_exact() -> None:
    rough = textured(np.random.default_rng(0))
    found = fit_light(drift(rough, np.array([0.7, 1.1, 1.0]), 5.0), rough)
    assert found.gain == pytest.approx([0.7, 1.1, 1.0], abs=5e-3)
    assert found.noise_levels < 0.4


@pytest.mark.parametrize("sigma", [0.07, 0.2, 1.0, 10.0])
@pytest.mark.parametrize("shade", [0.0, 3.0])
def test_a_wider_prior_makes_no_gain_of_noise(
    sigma: float, shade: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A background without shades of its own tells no gain, however little is known before."""
    monkeypatch.setattr("taccel_lab.calibration.light.fit.PRIOR_SIGMA", PRIOR_SIGMA * sigma / 0.07)
    rng = np.random.default_rng(2)
    # The slope over the image is what a gradient explains as well.
    flat = add_gradient(np.full((150, 200, 3), 120.0), shade, 0.0)
    noise = gaussian_filter(rng.normal(0, 1, (2, *flat.shape)), (0, 2, 2, 0))
    noise *= 2.0 / noise.std()
    found = fit_light(flat + noise[0] + 6.0, flat + noise[1])
    assert found.gain == pytest.approx([1.0] * 3, abs=0.1)
    assert np.abs(found.apply(flat) - flat - 6.0).mean() < 0.5


@given(
    seed=st.integers(0, 50), shades=st.floats(0.0, 40.0), noise=st.floats(0.1, 10.0),
    sigma=st.floats(0.01, 1e3),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_the_equations_of_the_drift_have_one_solution(
    seed: int, shades: float, noise: float, sigma: float
) -> None:
    rng = np.random.default_rng(seed)
    place = rng.uniform(-1, 1, (300, 2))
    level = 100 + shades * rng.normal(size=300) + 5 * place[:, 0] + rng.normal(0, noise, 300)
    design = np.column_stack([level, np.ones(300), place])
    weight = rng.uniform(0, 1, 300)
    prior = PRIOR_SIGMA * sigma / PRIOR_SIGMA[0]
    normal, _ = normal_equations(design, rng.normal(size=300), weight, noise, prior)
    scaled = normal / np.sqrt(np.outer(np.diag(normal), np.diag(normal)))
    assert np.allclose(normal, normal.T)
    assert np.linalg.eigvalsh(scaled).min() > 0


def test_a_gradient_needs_a_whole_image() -> None:
    tilted = Light(np.ones(3), np.zeros(3), np.ones((3, 2)))
    with pytest.raises(InputError, match="whole image"):
        tilted.remove(np.zeros((10, 3)))


def test_average_is_quieter_and_keeps_no_stain() -> None:
    rng = np.random.default_rng(3)
    light = lambda: (1 + rng.normal(0, 0.03, 3), rng.normal(0, 3, 3))  # noqa: E731
    presses = [
        quantise(add_noise(drift(pressed(c), *light()), 2.0, rng)) for c in scattered(16, seed=1)
    ]
    untouched = [quantise(add_noise(drift(gel(), *light()), 2.0, rng)) for _ in range(4)]
    background = quantise(add_noise(gel(), 2.0, rng))
    result = calibrate_background(capture_folder(background, untouched, presses))
    before = np.sqrt(np.mean((background - gel()) ** 2))
    after = np.sqrt(np.mean((result.image - gel()) ** 2))
    assert after < 0.55 * before
    # Smoothed over 9 px, nothing of the presses is left.
    stain = np.abs(np.stack([box(result.image[..., c] - gel()[..., c]) for c in range(3)]))
    assert stain.max() < 1.5
    assert result.noise_levels == pytest.approx(2.0, rel=0.2)
    assert result.spread is not None and result.spread.auto_white_balance
    figures = result.figures()
    assert figures["heldout_l1"] < figures["plain_l1"]
    block = result.apply_to(tiny_profile(GRID)).background
    assert block is not None and block.provenance.verdict == "usable"


def box(values: np.ndarray) -> np.ndarray:
    return uniform_filter(values, 9)


def test_background_from_presses_alone() -> None:
    rng = np.random.default_rng(5)
    presses = [quantise(add_noise(pressed(c), 1.0, rng)) for c in scattered(14, seed=1)]
    result = calibrate_background(capture_folder(None, [], presses))
    assert np.abs(result.image - gel()).mean() < 1.5
    assert "no_untouched_image" in {remark.code for remark in result.remarks}
    with pytest.raises(InputError, match="too few to make one"):
        calibrate_background(capture_folder(None, [], presses[:3]))
    same = [presses[0]] * 8
    with pytest.raises(InputError, match="spread over the gel"):
        # Eight times the same press, and eight of another: half touch each place.
        calibrate_background(capture_folder(None, [], [*same, *presses[1:2] * 8]))


def test_masked_pixels_have_no_effect() -> None:
    rng = np.random.default_rng(6)
    mask = np.ones((150, 200), dtype=bool)
    mask[20:60, 30:90] = False
    images = [quantise(add_noise(gel(), 1.5, rng)) for _ in range(4)]
    spoilt = [quantise(poison(image, mask, rng)) for image in images]
    first = calibrate_background(capture_folder(images[0], images[1:], [], mask))
    second = calibrate_background(capture_folder(images[0], spoilt[1:], [], mask))
    assert np.array_equal(first.image, second.image)
    assert first.figures()["drift"] == second.figures()["drift"]


def test_a_background_with_a_contact_in_it_is_weak() -> None:
    rng = np.random.default_rng(8)
    touched = ContactCircle(150.0, 50.0, 20.0)
    circles = [c for c in scattered(14, seed=3) if np.hypot(c.u_px - 150, c.v_px - 50) > 40]
    presses = [quantise(add_noise(pressed(circle), 1.5, rng)) for circle in circles]
    spoilt = quantise(add_noise(pressed(touched), 1.5, rng))
    found = calibrate_background(capture_folder(spoilt, [], presses))
    assert "background_pressed" in {remark.code for remark in found.remarks}
    assert found.figures()["verdict"] == "weak"
    # Nothing is said of what the mask hides, whatever the light does.
    mask = np.ones((150, 200), dtype=bool)
    mask[20:80, 118:182] = False
    warmer = [quantise(poison(drift(p, np.ones(3), np.full(3, 25.0)), mask, rng)) for p in presses]
    hidden = calibrate_background(capture_folder(spoilt, [], warmer, mask))
    assert "background_pressed" not in {remark.code for remark in hidden.remarks}


def test_dust_that_stays() -> None:
    rng = np.random.default_rng(7)
    dusty = add_dust(gel(), 12, np.random.default_rng(1), radius_px=1.5)
    background = quantise(add_noise(gel(), 1.0, rng))
    later = [quantise(add_noise(dusty, 1.0, rng)) for _ in range(4)]
    result = calibrate_background(capture_folder(background, later, []))
    assert "new_dust" in {remark.code for remark in result.remarks}
    truth = np.abs(dusty - gel())[..., 0] > 20
    assert (result.new_dust & truth).sum() > 0.8 * truth.sum()
    assert result.new_dust.mean() < 6 * truth.mean()
    assert speck_count(dust_mask(quantise(add_noise(gel(), 1.0, rng)))) == 0


def test_auto_white_balance_is_told_from_lamps_that_warm_up() -> None:
    rng = np.random.default_rng(8)
    zero = np.zeros(3)
    balance = [Light(1 + rng.normal(0, 0.05, 3), zero) for _ in range(20)]
    warming = [Light(np.full(3, 1 + 0.1 * k / 20), zero) for k in range(20)]
    steady = [Light(1 + rng.normal(0, 0.002, 3), zero) for _ in range(20)]
    assert drift_spread(balance, gel()).auto_white_balance
    assert not drift_spread(warming, gel()).auto_white_balance
    codes = [drift_remark(d, gel()).code for d in (balance, warming, steady)]
    assert codes == ["auto_white_balance", "light_drifts", "light_steady"]


def test_refusals() -> None:
    with pytest.raises(InputError, match="neither an untouched image nor presses"):
        calibrate_background(capture_folder(None, [], []))
    small = np.zeros((40, 50, 3), np.uint8)
    with pytest.raises(InputError, match="several sizes"):
        calibrate_background(capture_folder(quantise(gel()), [small], []))
    result = calibrate_background(capture_folder(quantise(gel()), [], []))
    other = dataclasses.replace(GRID, width_px=100, height_px=80)
    unscaled = dataclasses.replace(result, mm_per_px=None)
    with pytest.raises(InputError, match="state no scale"):
        unscaled.apply_to(tiny_profile(other))
    assert result.apply_to(tiny_profile(other)).camera.width_px == 200
