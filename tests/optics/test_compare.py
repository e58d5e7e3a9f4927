# SPDX-License-Identifier: Apache-2.0
"""Scores of model pictures: perfect for themselves, bad for what is wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.optics.compare import compare_backgrounds, compare_press, pressed_top


def ramp(slope: tuple[float, float, float]) -> np.ndarray:
    v, u = np.mgrid[:60, :80]
    image = 120 + np.stack([s * (u - 40) + 0.3 * (v - 30) for s in slope], axis=-1)
    return np.clip(image, 0, 255).astype(np.uint8)


def ball_colors(angle_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Background, and a disc whose channels each brighten on one side."""
    v, u = np.mgrid[:60, :80]
    du, dv = (u - 40) / 15, (v - 30) / 15
    disc = np.hypot(du, dv) < 1
    image = np.full((60, 80, 3), 120.0)
    for c in range(3):
        a = math.radians(angle_deg + 120 * c)
        image[..., c] += np.where(disc, 60 * (du * math.cos(a) + dv * math.sin(a)), 0)
    return np.full((60, 80, 3), 120, np.uint8), image.astype(np.uint8)


def test_background_scores() -> None:
    mask = np.ones((60, 80), bool)
    real = ramp((1.0, -0.5, 0.8))
    dimmer = (0.5 * real.astype(float) + 20).astype(np.uint8)
    same = compare_backgrounds(real, dimmer, mask, blur_px=2.0)
    assert min(same.correlation) > 0.999
    assert same.psnr_db > same.flat_psnr_db + 20
    mirrored = compare_backgrounds(real, real[:, ::-1], mask, blur_px=2.0)
    assert mirrored.correlation[0] < 0
    flat = compare_backgrounds(real, np.full_like(real, 90), mask, blur_px=2.0)
    assert flat.correlation == (0.0, 0.0, 0.0)
    assert flat.psnr_db == pytest.approx(flat.flat_psnr_db, abs=1e-6)


def test_nothing_outside_the_mask_counts() -> None:
    mask = np.zeros((60, 80), bool)
    mask[10:50, 10:70] = True
    real = ramp((1.0, -0.5, 0.8))
    spoiled = np.where(mask[..., None], real, 255).astype(np.uint8)
    assert compare_backgrounds(real, spoiled, mask, blur_px=3.0).psnr_db > 100


def test_press_scores_tell_the_sides_of_the_lights() -> None:
    real = ball_colors(0.0)
    same = compare_press(real, ball_colors(0.0), (40, 30), 15.0)
    assert same.mean_cosine == pytest.approx(1.0, abs=1e-3)
    assert min(same.correlation) > 0.99
    assert same.contrast == pytest.approx(1.0)
    half = ((real[1].astype(int) + real[0]) // 2).astype(np.uint8)
    assert compare_press(real, (real[0], half), (40, 30), 15.0).contrast == pytest.approx(
        0.5, abs=0.02
    )
    turned = compare_press(real, ball_colors(30.0), (40, 30), 15.0)
    assert turned.mean_cosine == pytest.approx(math.cos(math.radians(30)), abs=0.03)
    assert compare_press(real, ball_colors(180.0), (40, 30), 15.0).mean_cosine < -0.99


@given(a=st.floats(0.3, 2.5), ball=st.floats(2.6, 8.0))
def test_dent_joins_its_surroundings_smoothly(a: float, ball: float) -> None:
    def flat(xy: np.ndarray) -> np.ndarray:
        return np.zeros(xy.shape[:-1])

    top = pressed_top(flat, (1.0, -2.0), a, ball)
    along = np.array([0.0, 0.5, 1 - 1e-6, 1 + 1e-6, 3.0, 50.0]) * a
    z = top(np.stack([1.0 + along, np.full(6, -2.0)], axis=-1))
    # Johnson (3.42): the edge has sunk by a^2 / 2R, and far away the gel not at all.
    assert z[2] == pytest.approx(-a * a / (2 * ball), rel=1e-4)
    assert z[3] == pytest.approx(z[2], rel=1e-3)
    assert z[0] == pytest.approx(z[2] - (ball - math.sqrt(ball**2 - a**2)), rel=1e-4)
    assert (np.diff(z) > 0).all()
    assert abs(z[5]) < 0.01 * abs(z[0])
    thin = pressed_top(flat, (1.0, -2.0), a, ball, thin=True)
    z = thin(np.stack([1.0 + along, np.full(6, -2.0)], axis=-1))
    assert z[0] == pytest.approx(math.sqrt(ball**2 - a**2) - ball)
    np.testing.assert_allclose(z[3:], 0.0)
