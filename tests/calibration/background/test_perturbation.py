# SPDX-License-Identifier: Apache-2.0
"""A known spread is recovered from images drawn from it, and only measured values count."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.background.perturbation import perturbation_block, spread_of_units
from taccel_lab.errors import InputError
from taccel_lab.profile import BackgroundBlock, PerturbationBlock, Provenance, SensorProfile
from taccel_lab.reading.light import LightDrift, fit_light
from taccel_lab.signals.perturbation import draw_perturbation
from taccel_lab.signals.perturbed_sensors import PerturbedSensors
from tests.calibration.drawn.faults import add_noise, quantise
from tests.support.synthetic_presses import GRID, flat_background, tiny_profile

ASSUMED = Provenance(kind="assumed", method="made up for a test", source="none")
MEASURED = Provenance(kind="measured", method="made up for a test", source="none")
TRUTH = PerturbationBlock(
    gain_rgb=(0.10, 0.05, 0.15), pivot_rgb=(110.0, 115.0, 112.5), offset_rgb=(4.0, 2.0, 6.0),
    gradient_rgb=(3.0, 2.0, 4.0), noise_levels=0.0, provenance=ASSUMED,
)  # fmt: skip
PATTERN = np.random.default_rng(9).normal(0, 12, (GRID.height_px // 4, GRID.width_px // 4, 1))
BACKGROUND = flat_background() + np.kron(PATTERN, np.ones((4, 4, 1)))
"""With enough contrast to tell gain from offset."""
PIVOT = BACKGROUND.mean(axis=(0, 1))
PART = BACKGROUND[:60, :80]
"""How many frames there are limits what is found, not their pixels."""


def seen(block: PerturbationBlock, count: int, seed: int = 0) -> np.ndarray:
    draw = draw_perturbation(block, count, np.random.default_rng(seed))
    return PerturbedSensors(draw).apply(np.repeat(PART[None], count, axis=0))


def drawn_frames(count: int, noise: float) -> tuple[np.ndarray, list[LightDrift]]:
    """Frames of the true spread, and the light that is found in each."""
    frames = quantise(add_noise(seen(TRUTH, count), noise, np.random.default_rng(2)))
    return frames, [fit_light(frame, PART) for frame in frames]


@pytest.mark.thorough
def test_the_spread_of_many_frames_is_recovered() -> None:
    drifts = drawn_frames(200, 1.0)[1]
    found = perturbation_block(drifts, None, 1.0, PIVOT, {"a": "0" * 64}, "test")
    assert found is not None
    # A standard deviation from 200 samples is uncertain by 5 %: 3 of these.
    for name in ("gain_rgb", "offset_rgb", "gradient_rgb"):
        assert getattr(found, name) == pytest.approx(getattr(TRUTH, name), rel=0.15), name
    assert found.pivot_rgb == pytest.approx(PIVOT) and found.noise_levels == 1.0


@pytest.mark.thorough
def test_the_block_draws_images_like_the_measured_ones() -> None:
    frames, drifts = drawn_frames(100, 0.5)
    block = perturbation_block(drifts, None, None, PIVOT, {"a": "0" * 64}, "test")
    assert block is not None and block.provenance.verdict == "good"
    # The spread of a pixel between frames is what randomisation is about.
    first, second = frames.astype(float).std(axis=0), seen(block, 400, seed=1).std(axis=0)
    assert second.mean() == pytest.approx(first.mean(), rel=0.1)


def unit(brightness: float, young_pa: float, provenance: Provenance) -> SensorProfile:
    profile = tiny_profile(GRID)
    image = np.clip(BACKGROUND * brightness, 0, 255).astype(np.float32)
    return profile.with_block(BackgroundBlock(provenance=MEASURED), image).with_block(
        profile.material.replace(young_modulus_pa=young_pa, provenance=provenance)
    )


def test_units_are_compared_by_what_was_measured() -> None:
    brightness, moduli_pa = (0.9, 1.0, 1.1), (1.4e5, 1.5e5, 1.6e5)
    units = spread_of_units(
        [unit(b, e, MEASURED) for b, e in zip(brightness, moduli_pa, strict=True)]
    )
    assert units.values["young_modulus_relative"] == pytest.approx(0.1 / 1.5)
    assert "mm_per_px_relative" not in units.values  # the cameras were assumed
    for light, gain in zip(units.lights, brightness, strict=True):
        assert light.gain == pytest.approx([gain] * 3, abs=0.01)
    result = perturbation_block([], units, None, PIVOT, {"a": "0" * 64}, "test")
    assert result is not None and result.gain_rgb == pytest.approx((0.1, 0.1, 0.1), abs=0.005)
    (remark,) = result.provenance.remarks
    assert remark.startswith("warning: 3 units: each standard deviation is itself uncertain by 50%")
    assumed = spread_of_units([unit(b, e, ASSUMED) for b, e in ((1.0, 1e5), (1.1, 2e5))])
    assert not assumed.values


def test_too_little_is_refused() -> None:
    with pytest.raises(InputError, match="at least 2 profiles"):
        spread_of_units([tiny_profile(GRID)])
    one = fit_light(BACKGROUND, BACKGROUND)
    assert perturbation_block([one], None, None, np.full(3, 9.0), {}, "test") is None
    other = tiny_profile(GRID)
    other = other.with_block(other.sensor.replace(family="digit"))
    with pytest.raises(InputError, match="different families"):
        spread_of_units([tiny_profile(GRID), other])
    # Two copies of a unit agree, which says nothing of other units.
    behind = [MEASURED.replace(inputs={"a": digit * 64}) for digit in "012"]
    first = unit(1.0, 1e5, behind[0])
    with pytest.raises(InputError, match=r"profiles 1 and 2 .* captures behind the block"):
        spread_of_units([first, unit(1.1, 1.2e5, behind[0])])
    with pytest.raises(InputError, match="profiles 2 and 3 of the units hold the same image"):
        spread_of_units([first, unit(1.1, 1.2e5, behind[1]), unit(1.1, 1.3e5, behind[2])])
