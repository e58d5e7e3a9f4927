# SPDX-License-Identifier: Apache-2.0
"""Draws follow the stated spread, and images change as the draw says, in numpy and in torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import PerturbationBlock
from taccel_lab.signals.perturbation import Perturbation, SensorFaults, draw_perturbation
from taccel_lab.signals.perturbed_sensors import PerturbedSensors
from tests.support.sample_blocks import ASSUMED

BLOCK = PerturbationBlock(
    gain_rgb=(0.05, 0.1, 0.02),
    pivot_rgb=(120.0, 100.0, 80.0),
    offset_rgb=(2.0, 1.0, 3.0),
    gradient_rgb=(4.0, 2.0, 1.0),
    noise_levels=1.5,
    mm_per_px_relative=0.02,
    center_px=3.0,
    young_modulus_relative=0.1,
    friction_coefficient=0.05,
    provenance=ASSUMED,
)


def draw(count: int = 2, seed: int = 0, **options: float) -> Perturbation:
    return draw_perturbation(BLOCK, count, np.random.default_rng(seed), **options)


def test_draws_have_the_stated_spread():
    many = draw(20_000)
    for values, spread in (
        (many.gain, BLOCK.gain_rgb),
        (many.offset, BLOCK.offset_rgb),
        (many.gradient.reshape(-1, 3), BLOCK.gradient_rgb),
        (many.scale_factor, 0.02),
        (many.center_shift_px, (3.0, 3.0)),
        (many.young_modulus_pa(1e5), 1e4),
    ):
        assert values.std(axis=0) == pytest.approx(spread, rel=0.03)
    assert many.friction_coefficient(0.5).mean() == pytest.approx(0.5, abs=0.002)
    assert draw(4, 1).gain == pytest.approx(draw(4, 1).gain)


def test_strength_zero_is_the_nominal_sensor():
    none, grid = draw(3, strength=0.0), PixelGrid(8, 6, 0.1, 0.2)
    images = np.random.default_rng(2).uniform(0, 255, (3, 6, 8, 3)).astype(np.float32)
    assert np.array_equal(PerturbedSensors(none).apply(images, np.random.default_rng(3)), images)
    assert none.grid(grid, 1) == grid


def test_an_image_changes_as_the_draw_says():
    one = draw()
    changed = PerturbedSensors(one).apply(np.full((2, 5, 9, 3), 100.0))
    pivot = np.array(BLOCK.pivot_rgb)
    assert changed[:, 2, 4] == pytest.approx(pivot + (100 - pivot) * one.gain + one.offset)
    eps = 128 * float(np.finfo(np.float32).eps)  # Levels are float32: a difference of two near 100.
    assert changed[:, 2, 8] - changed[:, 2, 4] == pytest.approx(one.gradient[:, 0], abs=eps)
    assert changed[:, 4, 4] - changed[:, 2, 4] == pytest.approx(one.gradient[:, 1], abs=eps)


def test_torch_gives_what_numpy_gives():
    images = np.random.default_rng(2).uniform(50, 200, (2, 6, 8, 3)).astype(np.float32)
    given = (images, torch.from_numpy(images))
    by_numpy, by_torch = (PerturbedSensors(draw()).apply(each) for each in given)
    assert isinstance(by_torch, torch.Tensor) and by_torch.dtype == torch.float32
    assert by_torch.numpy() == pytest.approx(by_numpy, abs=1e-4)


@pytest.mark.parametrize("kind", [np.asarray, torch.from_numpy])
def test_noise_is_drawn_anew_and_has_its_size(kind):
    images = kind(np.full((2, 60, 80, 3), 120.0, dtype=np.float32))
    rng, sensors = np.random.default_rng(5), PerturbedSensors(draw())
    first, second, clean = (np.asarray(sensors.apply(images, by)) for by in (rng, rng, None))
    assert (first - clean).std() == pytest.approx(1.5, rel=0.05)
    assert (first - second).std() == pytest.approx(1.5 * np.sqrt(2), rel=0.05)


def test_light_and_camera_leave_taxels_as_they_are():
    taxels = IMAGES[..., :2] - 500
    assert (PerturbedSensors(draw()).apply(taxels, np.random.default_rng(1)) == taxels).all()


IMAGES = np.random.default_rng(2).uniform(40, 120, (2, 41, 51, 3)).astype(np.float32)


def faulty(**faults: object) -> Perturbation:
    """Two sensors that differ from the nominal one by faults alone."""
    return draw(strength=0.0, faults=SensorFaults(**faults))


def shown(images: np.ndarray, **faults: object) -> np.ndarray:
    return PerturbedSensors(faulty(**faults)).apply(images)


def test_dead_pixels_stay_dead_in_all_channels():
    sensors = PerturbedSensors(faulty(dead_share=0.1, dead_range=(200.0, 210.0)))
    first, again = (sensors.apply(IMAGES) for _ in range(2))
    dead = first != IMAGES
    assert (dead == dead[..., :1]).all() and (first == again).all()
    assert dead[..., 0].mean() == pytest.approx(0.1, abs=0.02)
    assert 200 <= first[dead].min() and first[dead].max() <= 210.001
    assert not (dead[0] == dead[1]).all()  # Each sensor has its own.


def test_gains_of_pixels_spread_and_stay():
    taxels = np.ones((2, 60, 80, 1), np.float32)
    gains = shown(taxels, pixel_gain=0.05)
    assert gains.std() == pytest.approx(0.05, rel=0.05)
    assert gains.mean() == pytest.approx(1, abs=0.01)
    assert (shown(2 * taxels, pixel_gain=0.05) == 2 * gains).all()


def test_crosstalk_is_the_mean_of_the_neighbours():
    taxels = np.zeros((2, 21, 25, 1), np.float32)
    taxels[:, 10, 12] = 1.0
    seen = shown(taxels, crosstalk=0.4, crosstalk_px=1.5)
    away = np.arange(25) - 12
    weights = np.where(abs(away) <= 5, np.exp(-0.5 * (away / 1.5) ** 2), 0.0)
    mean = weights * weights[12] / weights.sum() ** 2
    assert seen[0, 10, :, 0] == pytest.approx(0.6 * taxels[0, 10, :, 0] + 0.4 * mean, abs=1e-6)
    assert seen.sum(axis=(1, 2, 3)) == pytest.approx(1.0, abs=1e-5)


def test_hysteresis_overshoots_and_fades_as_a_maxwell_branch_does():
    sensors = PerturbedSensors(faulty(hysteresis=0.5, hysteresis_s=0.2))
    rest, pressed = (np.full((2, 3, 4, 1), level, np.float32) for level in (1.0, 3.0))
    assert (sensors.apply(rest, step_s=0.05) == rest).all()
    seen = [float(sensors.apply(pressed, step_s=0.05)[0, 0, 0, 0]) for _ in range(8)]
    kept = np.exp(-0.05 / 0.2)
    assert seen == pytest.approx(3 + 0.5 * 2 * kept ** np.arange(1, 9), abs=1e-5)
    assert sensors.apply(rest, step_s=0.05).max() < 1.0  # Below rest, for a while.
    sensors.reset(np.array([True, False]))
    after = sensors.apply(rest, step_s=0.05)[:, 0, 0, 0]
    assert after[0] == 1.0 and after[1] < 1.0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: draw(0), "at least 1"),
        (lambda: draw(1, strength=-1.0), "zero or positive"),
        (lambda: PerturbedSensors(draw()).apply(np.zeros((3, 4, 4, 3))), "shape"),
        (lambda: SensorFaults(dead_share=1.5), "dead_share is 1.5"),
        (lambda: SensorFaults(hysteresis=-0.1), "hysteresis is -0.1"),
        (lambda: SensorFaults(crosstalk_px=0.0), "crosstalk_px is 0.0"),
        (lambda: SensorFaults(dead_range=(2.0, 1.0)), "dead_range"),
        (lambda: shown(np.zeros((2, 4, 4, 3)), hysteresis=0.5), "hysteresis needs step_s"),
    ],
)
def test_bad_arguments_are_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()
