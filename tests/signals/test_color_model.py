# SPDX-License-Identifier: Apache-2.0
"""The colour model and its images: anchoring at rest, chunks, slopes beyond those of the balls."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.signals.color_model import CHUNK_PIXELS, ColorModel
from taccel_lab.signals.tactile_image import tactile_image
from tests.networks.weights import random_weights
from tests.signals.host_colors import face, host_change

CONFIG = ColorModelConfig(width_px=20, height_px=15, hidden=(16, 8))
UPRIGHT = np.tile([0.0, 0.0, 1.0], (15, 20, 1))


def random_model(config: ColorModelConfig = CONFIG, seed: int = 0, *cone: float) -> ColorModel:
    return ColorModel(config, random_weights(config, seed, 0.5), *cone)


def random_normals(shape: tuple[int, ...], seed: int = 0, spread: float = 0.5) -> np.ndarray:
    slope = np.random.default_rng(seed).normal(0, spread, (*shape, 2))
    normals = np.concatenate([-slope, np.ones((*shape, 1))], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def test_forward_pass_by_hand():
    config = ColorModelConfig(
        width_px=3, height_px=2, hidden=(1,), inputs=("u", "normal_x", "displacement_mm"),
        input_mean=(0.0, 0.0, 0.5), input_scale=(1.0, 2.0, 4.0), output_scale=10.0,
        activation="tanh",
    )  # fmt: skip
    weights = {
        "layer0.weight": np.array([[0.3, 0.7, -0.2]]),
        "layer0.bias": np.array([0.1]),
        "layer1.weight": np.array([[1.0], [2.0], [-1.0]]),
        "layer1.bias": np.array([5.0, 6.0, 7.0]),
    }
    rest, displacement = UPRIGHT[:2, :3], np.zeros((2, 3))
    normals = rest.copy()
    normals[1, 2], displacement[1, 2] = [0.6, 0.0, 0.8], -1.5
    change = host_change(ColorModel(config, weights), normals, displacement, rest)
    # Pixel (row 1, column 2): u = 1.
    pressed = math.tanh(0.3 * 1 + 0.7 * 0.6 / 2 - 0.2 * (-1.5 - 0.5) / 4 + 0.1)
    at_rest = math.tanh(0.3 * 1 - 0.2 * (0 - 0.5) / 4 + 0.1)
    expected = 10 * (pressed - at_rest) * np.array([1.0, 2.0, -1.0])
    assert change[1, 2] == pytest.approx(expected, rel=1e-5)
    assert np.count_nonzero(change) == 3


@pytest.mark.thorough
@settings(max_examples=20)
@given(seed=st.integers(0, 999))
def test_undeformed_pixels_do_not_change(seed):
    rest = random_normals((15, 20), seed)
    moved = np.random.default_rng(seed).random((15, 20)) < 0.3
    pressed = face(rest, np.where(moved, -0.4, 0.0), rest)
    image = tactile_image(random_model(seed=seed), np.full((15, 20, 3), 120.0), pressed)
    assert (image[~moved] == 120.0).all()
    assert (np.abs(image[moved] - 120.0).sum(axis=-1) > 0).all()


def test_chunks_leave_no_seam():
    shape = (130, CHUNK_PIXELS // 100)
    model = random_model(replace(CONFIG, width_px=shape[1], height_px=shape[0]))
    normals, rest = random_normals(shape), random_normals(shape, 1)
    whole = host_change(model, normals, np.full(shape, -0.3), rest).reshape(-1, 3)
    idx = np.array([0, CHUNK_PIXELS - 1, CHUNK_PIXELS, CHUNK_PIXELS + 1, whole.shape[0] - 1])
    some = model.predict_pixels(
        idx, normals.reshape(-1, 3)[idx], np.full(5, -0.3), rest.reshape(-1, 3)[idx]
    )
    assert some == pytest.approx(whole[idx], abs=1e-4)


def test_maps_and_cones_that_are_none_are_refused():
    model, normals = random_model(), random_normals((15, 20))
    with pytest.raises(InputError, match="background has shape"):
        tactile_image(model, np.zeros((15, 21, 3)), face(normals, np.zeros((15, 20)), normals))
    with pytest.raises(InputError, match="pixel grid has"):
        small = face(normals[:10], np.zeros((10, 20)), normals[:10])
        tactile_image(model, np.zeros((15, 20, 3)), small)
    for cone_deg in (0.0, 90.1, float("nan")):
        with pytest.raises(InputError, match="surface_tilt_deg"):
            random_model(CONFIG, 0, cone_deg)


def test_steeper_than_the_balls_were_is_as_steep_as_they_were():
    """By the network alone it is another colour; below the cone nothing changes."""
    whole, model = random_model(), random_model(CONFIG, 0, 50.0)
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)

    def change(network, tilt_deg):
        return network.predict_pixels(
            np.arange(12) * 7, leaning(tilt_deg), np.full(12, -0.3), leaning(3.0)
        )

    def leaning(tilt_deg):
        tilt = np.radians(tilt_deg)
        side = np.sin(tilt) * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        return np.column_stack([side, np.full(12, np.cos(tilt))])

    edge = change(whole, 50.0)
    for tilt_deg in (0.0, 30.0, 49.9):
        assert change(model, tilt_deg) == pytest.approx(change(whole, tilt_deg), abs=1e-4)
    for tilt_deg in (51.0, 70.0, 89.0):
        assert change(model, tilt_deg) == pytest.approx(edge, abs=1e-4)
    assert np.abs(change(whole, 89.0) - edge).max() > 5.0


@pytest.mark.parametrize("cone_deg", [20.0, 60.0])
def test_the_kernel_keeps_to_the_same_cone(cone_deg):
    normals = random_normals((15, 20), 2, spread=1.5)
    depth = np.random.default_rng(3).uniform(-0.5, 0.0, (15, 20))
    back, model = np.full((15, 20, 3), 128.0), random_model(CONFIG, 0, cone_deg)
    image = tactile_image(model, back, face(normals, depth, UPRIGHT))
    wanted = np.clip(back + host_change(model, normals, depth, UPRIGHT), 0, 255)
    assert np.abs(image - wanted).max() < 1e-2
