# SPDX-License-Identifier: Apache-2.0
"""Light of single frames, and how it changes over many."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from taccel_lab.calibration.light.drift import drift_remark, drift_spread
from taccel_lab.calibration.light.fit import PRIOR_SIGMA, fit_light, normal_equations
from taccel_lab.calibration.light.light import Light
from taccel_lab.errors import InputError
from tests.calibration.contacts.presses import gel, pressed, scattered
from tests.calibration.drawn.faults import (
    add_gradient,
    add_noise,
    drift,
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
    shape = (3, 300)
    levels = 100 + shades * rng.normal(size=shape) + 5 * place[:, 0] + rng.normal(0, noise, shape)
    others = np.stack([np.ones(300), *place.T])
    weight = rng.uniform(0, 1, 300)
    prior = PRIOR_SIGMA * sigma / PRIOR_SIGMA[0]
    matrices, _ = normal_equations(levels, others, rng.normal(size=shape), weight, noise, prior)
    for normal in matrices:
        scaled = normal / np.sqrt(np.outer(np.diag(normal), np.diag(normal)))
        assert np.allclose(normal, normal.T)
        assert np.linalg.eigvalsh(scaled).min() > 0


def test_a_gradient_needs_a_whole_image() -> None:
    tilted = Light(np.ones(3), np.zeros(3), np.ones((3, 2)))
    with pytest.raises(InputError, match="whole image"):
        tilted.remove(np.zeros((10, 3)))


def test_auto_white_balance_is_told_from_lamps_that_warm_up() -> None:
    rng = np.random.default_rng(8)
    zero = np.zeros(3)
    balance = [Light(1 + rng.normal(0, 0.05, 3), zero) for _ in range(20)]
    warming = [Light(np.full(3, 1 + 0.1 * k / 20), zero) for k in range(20)]
    steady = [Light(1 + rng.normal(0, 0.002, 3), zero) for _ in range(20)]
    assert drift_spread(balance, gel()).auto_white_balance
    assert not drift_spread(warming, gel()).auto_white_balance
    codes = [drift_remark(d, gel()).code for d in (balance, warming, steady)]
    assert codes == ["channels_drift", "light_drifts", "light_steady"]
