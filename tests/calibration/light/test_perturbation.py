# SPDX-License-Identifier: Apache-2.0
"""A known spread is recovered from images drawn from it, and only measured values count."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from taccel_lab.calibration.frame_light import LightDrift, fit_light
from taccel_lab.calibration.light.perturbation import (
    UnitSpread,
    perturbation_block,
    spread_of_units,
)
from taccel_lab.errors import InputError
from taccel_lab.profile import BackgroundBlock, PerturbationBlock, Provenance, SensorProfile
from taccel_lab.signals.perturbation import draw_perturbation
from taccel_lab.signals.perturbed_sensors import PerturbedSensors
from tests.calibration.drawn.faults import add_noise, quantise
from tests.support.synthetic_presses import GRID, flat_background, tiny_profile

ASSUMED = Provenance(kind="assumed", method="made up for a test", source="none")
MEASURED = Provenance(kind="measured", method="made up for a test", source="none")
TRUTH = PerturbationBlock(
    gain_rgb=(0.10, 0.05, 0.15),
    pivot_rgb=(110.0, 115.0, 112.5),
    offset_rgb=(4.0, 2.0, 6.0),
    gradient_rgb=(3.0, 2.0, 4.0),
    noise_levels=0.0,
    provenance=ASSUMED,
)


def textured_background() -> np.ndarray:
    """Enough contrast to tell gain from offset."""
    rng = np.random.default_rng(9)
    pattern = rng.normal(0, 12, (GRID.height_px // 4, GRID.width_px // 4, 1))
    return flat_background() + np.kron(pattern, np.ones((4, 4, 1)))


def spread(
    drifts: Sequence[LightDrift], units: UnitSpread | None = None, noise_levels: float | None = None
) -> PerturbationBlock:
    pivot = textured_background().mean(axis=(0, 1))
    block = perturbation_block(drifts, units, noise_levels, pivot, {"a": "0" * 64}, "test")
    assert block is not None
    return block


def drawn_frames(count: int, noise: float, background: np.ndarray, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    draw = draw_perturbation(TRUTH, count, rng)
    frames = PerturbedSensors(draw).apply(np.repeat(background[None], count, axis=0))
    return quantise(add_noise(frames, noise, rng))


@pytest.mark.thorough
def test_the_spread_of_many_frames_is_recovered() -> None:
    count = 200
    # A quarter of the picture: how many frames there are limits what is found, not their pixels.
    background = textured_background()[:60, :80]
    drifts = [fit_light(frame, background) for frame in drawn_frames(count, 1.0, background)]
    found = spread(drifts, noise_levels=1.0)
    # A standard deviation from 200 samples is uncertain by 5 %: 3 of these.
    for name in ("gain_rgb", "offset_rgb", "gradient_rgb"):
        assert getattr(found, name) == pytest.approx(getattr(TRUTH, name), rel=0.15), name
    pivot = textured_background().mean(axis=(0, 1))
    assert found.pivot_rgb == pytest.approx(pivot)
    assert found.noise_levels == 1.0


@pytest.mark.thorough
def test_the_block_draws_images_like_the_measured_ones() -> None:
    background = textured_background()[:60, :80]
    frames = drawn_frames(100, 0.5, background)
    drifts = [fit_light(frame, background) for frame in frames]
    block = spread(drifts)
    assert block.provenance.verdict == "good"
    draw = draw_perturbation(block, 400, np.random.default_rng(1))
    again = PerturbedSensors(draw).apply(np.repeat(background[None], 400, axis=0))
    # The spread of a pixel between frames is what randomisation is about.
    first, second = frames.astype(float).std(axis=0), again.std(axis=0)
    assert second.mean() == pytest.approx(first.mean(), rel=0.1)


def unit(brightness: float, young_pa: float, provenance: Provenance) -> SensorProfile:
    profile = tiny_profile(GRID)
    image = np.clip(textured_background() * brightness, 0, 255).astype(np.float32)
    return profile.with_block(BackgroundBlock(provenance=MEASURED), image).with_block(
        profile.material.replace(young_modulus_pa=young_pa, provenance=provenance)
    )


def test_units_are_compared_by_what_was_measured() -> None:
    units = spread_of_units(
        [unit(b, e, MEASURED) for b, e in ((0.9, 1.4e5), (1.0, 1.5e5), (1.1, 1.6e5))]
    )
    assert units.values["young_modulus_relative"] == pytest.approx(0.1 / 1.5)
    assert "mm_per_px_relative" not in units.values  # the cameras were assumed
    gains = np.array([light.gain for light in units.lights])
    assert gains == pytest.approx(np.array([0.9, 1.0, 1.1])[:, None].repeat(3, 1), abs=0.01)
    result = spread([], units)
    assert result.gain_rgb == pytest.approx((0.1, 0.1, 0.1), abs=0.005)
    (remark,) = result.provenance.remarks
    assert remark.startswith("warning: 3 units: each standard deviation is itself uncertain by 50%")
    assumed = spread_of_units([unit(b, e, ASSUMED) for b, e in ((1.0, 1e5), (1.1, 2e5))])
    assert not assumed.values


def test_too_little_is_refused() -> None:
    with pytest.raises(InputError, match="at least 2 profiles"):
        spread_of_units([tiny_profile(GRID)])
    one = fit_light(textured_background(), textured_background())
    assert perturbation_block([one], None, None, np.full(3, 9.0), {}, "test") is None
    other = tiny_profile(GRID)
    other = other.with_block(other.sensor.replace(family="digit"))
    with pytest.raises(InputError, match="different families"):
        spread_of_units([tiny_profile(GRID), other])


def test_one_unit_given_twice_is_refused() -> None:
    """Two copies agree, which says nothing of other units."""
    measured = Provenance(kind="measured", method="m", source="s", inputs={"a": "0" * 64})
    first, second = unit(1.0, 1e5, measured), unit(1.1, 1.2e5, measured)
    with pytest.raises(InputError, match=r"profiles 1 and 2 .* captures behind the block"):
        spread_of_units([first, second])
    other = measured.replace(inputs={"a": "1" * 64})
    with pytest.raises(InputError, match="profiles 2 and 3 of the units hold the same image"):
        spread_of_units([first, unit(1.1, 1.2e5, other), unit(1.1, 1.3e5, Provenance(
            kind="measured", method="m", source="s", inputs={"a": "2" * 64}))])  # fmt: skip
