# SPDX-License-Identifier: Apache-2.0
"""Draws follow the stated spread, and images change as the draw says, in numpy and in torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import PerturbationBlock, Provenance
from taccel_lab.signals.perturbation import Perturbation, SensorFaults, draw_perturbation
from taccel_lab.signals.perturbed_sensors import PerturbedSensors

PROVENANCE = Provenance(kind="assumed", method="made up for a test", source="none")
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
    provenance=PROVENANCE,
)


def test_draws_have_the_stated_spread():
    draw = draw_perturbation(BLOCK, 20_000, np.random.default_rng(0))
    assert draw.gain.std(axis=0) == pytest.approx(BLOCK.gain_rgb, rel=0.03)
    assert draw.offset.std(axis=0) == pytest.approx(BLOCK.offset_rgb, rel=0.03)
    assert draw.gradient.std(axis=(0, 1)) == pytest.approx(BLOCK.gradient_rgb, rel=0.03)
    assert draw.scale_factor.std() == pytest.approx(0.02, rel=0.03)
    assert draw.center_shift_px.std(axis=0) == pytest.approx((3.0, 3.0), rel=0.03)
    assert draw.young_modulus_pa(1e5).std() == pytest.approx(1e4, rel=0.03)
    assert draw.friction_coefficient(0.5).mean() == pytest.approx(0.5, abs=0.002)
    assert draw_perturbation(BLOCK, 4, np.random.default_rng(1)).gain == pytest.approx(
        draw_perturbation(BLOCK, 4, np.random.default_rng(1)).gain
    )


def test_strength_zero_is_the_nominal_sensor():
    draw = draw_perturbation(BLOCK, 3, np.random.default_rng(0), strength=0.0)
    images = np.random.default_rng(2).uniform(0, 255, (3, 6, 8, 3)).astype(np.float32)
    assert np.array_equal(PerturbedSensors(draw).apply(images, np.random.default_rng(3)), images)
    grid = PixelGrid(8, 6, 0.1, 0.2)
    assert draw.grid(grid, 1) == grid


def test_an_image_changes_as_the_draw_says():
    draw = draw_perturbation(BLOCK, 2, np.random.default_rng(0))
    images = np.full((2, 5, 9, 3), 100.0)
    changed = PerturbedSensors(draw).apply(images)
    assert changed[:, 2, 4] == pytest.approx(
        BLOCK.pivot_rgb + (100 - np.array(BLOCK.pivot_rgb)) * draw.gain + draw.offset
    )
    eps = 128 * float(np.finfo(np.float32).eps)  # Levels are float32: a difference of two near 100.
    assert changed[:, 2, 8] - changed[:, 2, 4] == pytest.approx(draw.gradient[:, 0], abs=eps)
    assert changed[:, 4, 4] - changed[:, 2, 4] == pytest.approx(draw.gradient[:, 1], abs=eps)


def test_torch_gives_what_numpy_gives():
    draw = draw_perturbation(BLOCK, 2, np.random.default_rng(0))
    images = np.random.default_rng(2).uniform(50, 200, (2, 6, 8, 3)).astype(np.float32)
    both = (
        PerturbedSensors(draw).apply(images),
        PerturbedSensors(draw).apply(torch.from_numpy(images)),
    )
    assert isinstance(both[1], torch.Tensor) and both[1].dtype == torch.float32
    assert both[1].numpy() == pytest.approx(both[0], abs=1e-4)


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_noise_is_drawn_anew_and_has_its_size(kind):
    draw = draw_perturbation(BLOCK, 2, np.random.default_rng(0))
    images = np.full((2, 60, 80, 3), 120.0, dtype=np.float32)
    given = images if kind == "numpy" else torch.from_numpy(images)
    rng = np.random.default_rng(5)
    first, second = (np.asarray(PerturbedSensors(draw).apply(given, rng)) for _ in range(2))
    clean = np.asarray(PerturbedSensors(draw).apply(given))
    assert (first - clean).std() == pytest.approx(1.5, rel=0.05)
    assert (first - second).std() == pytest.approx(1.5 * np.sqrt(2), rel=0.05)


def test_bad_arguments_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="at least 1"):
        draw_perturbation(BLOCK, 0, rng)
    with pytest.raises(InputError, match="zero or positive"):
        draw_perturbation(BLOCK, 1, rng, strength=-1.0)
    with pytest.raises(InputError, match="shape"):
        PerturbedSensors(draw_perturbation(BLOCK, 2, rng)).apply(np.zeros((3, 4, 4, 3)))
    for name, value in (("dead_share", 1.5), ("hysteresis", -0.1), ("crosstalk_px", 0.0)):
        with pytest.raises(InputError, match=f"{name} is {value}"):
            SensorFaults(**{name: value})  # type: ignore
    with pytest.raises(InputError, match="dead_range"):
        SensorFaults(dead_range=(2.0, 1.0))
    slow = drawn(SensorFaults(hysteresis=0.5))
    with pytest.raises(InputError, match="hysteresis needs step_s"):
        PerturbedSensors(slow).apply(np.zeros((2, 4, 4, 3)))


def drawn(faults: SensorFaults) -> Perturbation:
    """Two sensors that differ from the nominal one by ``faults`` alone."""
    return draw_perturbation(BLOCK, 2, np.random.default_rng(0), strength=0.0, faults=faults)


IMAGES = np.random.default_rng(2).uniform(40, 120, (2, 41, 51, 3)).astype(np.float32)


def test_dead_pixels_stay_dead_in_all_channels():
    draw = drawn(SensorFaults(dead_share=0.1, dead_range=(200.0, 210.0)))
    first, again = (PerturbedSensors(draw).apply(IMAGES) for _ in range(2))
    dead = first != IMAGES
    assert (dead == dead[..., :1]).all() and (first == again).all()
    assert dead[..., 0].mean() == pytest.approx(0.1, abs=0.02)
    assert 200 <= first[dead].min() and first[dead].max() <= 210.001
    assert not (dead[0] == dead[1]).all()  # Each sensor has its own.


def test_gains_of_pixels_spread_and_stay():
    draw = drawn(SensorFaults(pixel_gain=0.05))
    taxels = np.ones((2, 60, 80, 1), np.float32)
    gains = PerturbedSensors(draw).apply(taxels)
    assert gains.std() == pytest.approx(0.05, rel=0.05) and gains.mean() == pytest.approx(
        1, abs=0.01
    )
    assert (PerturbedSensors(draw).apply(2 * taxels) == 2 * gains).all()


def test_crosstalk_is_the_mean_of_the_neighbours():
    taxels = np.zeros((2, 21, 25, 1), np.float32)
    taxels[:, 10, 12] = 1.0
    seen = PerturbedSensors(drawn(SensorFaults(crosstalk=0.4, crosstalk_px=1.5))).apply(taxels)
    away = np.arange(25) - 12
    weights = np.where(abs(away) <= 5, np.exp(-0.5 * (away / 1.5) ** 2), 0.0)
    assert seen[0, 10, :, 0] == pytest.approx(
        0.6 * taxels[0, 10, :, 0] + 0.4 * weights * weights[12] / weights.sum() ** 2, abs=1e-6
    )
    assert seen.sum(axis=(1, 2, 3)) == pytest.approx(1.0, abs=1e-5)


def test_hysteresis_overshoots_and_fades_as_a_maxwell_branch_does():
    sensors = PerturbedSensors(drawn(SensorFaults(hysteresis=0.5, hysteresis_s=0.2)))
    rest, pressed = (np.full((2, 3, 4, 1), level, np.float32) for level in (1.0, 3.0))
    assert (sensors.apply(rest, step_s=0.05) == rest).all()
    seen = [float(sensors.apply(pressed, step_s=0.05)[0, 0, 0, 0]) for _ in range(8)]
    kept = np.exp(-0.05 / 0.2)
    assert seen == pytest.approx(3 + 0.5 * 2 * kept ** np.arange(1, 9), abs=1e-5)
    unloaded = sensors.apply(rest, step_s=0.05)
    assert unloaded.max() < 1.0  # Below rest, for a while.
    sensors.reset(np.array([True, False]))
    after = sensors.apply(rest, step_s=0.05)[:, 0, 0, 0]
    assert after[0] == 1.0 and after[1] < 1.0


def test_lamps_dim_and_coatings_wear():
    draw = drawn(SensorFaults(lamp_dimming=0.2))
    assert (draw.lamps <= 1).all() and np.ptp(draw.lamps) > 0.05
    dimmed = PerturbedSensors(draw).apply(IMAGES)
    assert dimmed == pytest.approx(IMAGES * draw.lamps[:, None, None], abs=1e-4)
    draw = drawn(SensorFaults(wear=0.8, wear_radius=0.4))
    worn = PerturbedSensors(draw).apply(np.full_like(IMAGES, 100.0))
    across, down = np.meshgrid(np.linspace(-1, 1, 51), np.linspace(-1, 1, 41))
    for image, (x, y, radius, lost) in zip(worn, draw.worn, strict=True):
        expected = 1 - lost * np.exp(-0.5 * ((across - x) ** 2 + (down - y) ** 2) / radius**2)
        assert image[..., 1] == pytest.approx(100 * expected, abs=1e-3)


def test_light_and_camera_leave_taxels_as_they_are():
    draw = draw_perturbation(BLOCK, 2, np.random.default_rng(0))
    taxels = IMAGES[..., :2] - 500
    assert (PerturbedSensors(draw).apply(taxels, np.random.default_rng(1)) == taxels).all()
