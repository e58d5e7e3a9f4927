# SPDX-License-Identifier: Apache-2.0
"""Draws follow the stated spread, and images change as the draw says, in numpy and in torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import PerturbationBlock, Provenance
from taccel_lab.signals.perturbation import draw_perturbation

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


def test_draws_have_the_stated_spread() -> None:
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


def test_strength_zero_is_the_nominal_sensor() -> None:
    draw = draw_perturbation(BLOCK, 3, np.random.default_rng(0), strength=0.0)
    images = np.random.default_rng(2).uniform(0, 255, (3, 6, 8, 3)).astype(np.float32)
    assert np.array_equal(draw.apply(images, np.random.default_rng(3)), images)
    grid = PixelGrid(8, 6, 0.1, 0.2)
    assert draw.grid(grid, 1) == grid


def test_an_image_changes_as_the_draw_says() -> None:
    draw = draw_perturbation(BLOCK, 2, np.random.default_rng(0))
    images = np.full((2, 5, 9, 3), 100.0)
    changed = draw.apply(images)
    assert changed[:, 2, 4] == pytest.approx(
        BLOCK.pivot_rgb + (100 - np.array(BLOCK.pivot_rgb)) * draw.gain + draw.offset
    )
    assert changed[:, 2, 8] - changed[:, 2, 4] == pytest.approx(draw.gradient[:, 0])
    assert changed[:, 4, 4] - changed[:, 2, 4] == pytest.approx(draw.gradient[:, 1])


def test_torch_gives_what_numpy_gives() -> None:
    draw = draw_perturbation(BLOCK, 2, np.random.default_rng(0))
    images = np.random.default_rng(2).uniform(50, 200, (2, 6, 8, 3)).astype(np.float32)
    both = draw.apply(images), draw.apply(torch.from_numpy(images))
    assert isinstance(both[1], torch.Tensor) and both[1].dtype == torch.float32
    assert both[1].numpy() == pytest.approx(both[0], abs=1e-4)


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_noise_is_drawn_anew_and_has_its_size(kind: str) -> None:
    draw = draw_perturbation(BLOCK, 2, np.random.default_rng(0))
    images = np.full((2, 60, 80, 3), 120.0, dtype=np.float32)
    given = images if kind == "numpy" else torch.from_numpy(images)
    rng = np.random.default_rng(5)
    first, second = (np.asarray(draw.apply(given, rng)) for _ in range(2))
    clean = np.asarray(draw.apply(given))
    assert (first - clean).std() == pytest.approx(1.5, rel=0.05)
    assert (first - second).std() == pytest.approx(1.5 * np.sqrt(2), rel=0.05)


def test_bad_arguments_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="at least 1"):
        draw_perturbation(BLOCK, 0, rng)
    with pytest.raises(InputError, match="zero or positive"):
        draw_perturbation(BLOCK, 1, rng, strength=-1.0)
    with pytest.raises(InputError, match="shape"):
        draw_perturbation(BLOCK, 2, rng).apply(np.zeros((3, 4, 4, 3)))
