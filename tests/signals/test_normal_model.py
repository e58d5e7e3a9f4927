# SPDX-License-Identifier: Apache-2.0
"""The inverse model: frames, rest, masks and features."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.signals.color_model import (
    ACTIVATIONS,
    ColorModel,
    ColorModelConfig,
    pixel_uv,
    stack_inputs,
)
from taccel_lab.signals.color_model import expected_shapes as color_shapes
from taccel_lab.signals.network_answers import forward
from taccel_lab.signals.normal_features import color_change, local_features, pixel_place
from taccel_lab.signals.normal_model import NormalModel, expected_shapes, relative_normals
from taccel_lab.signals.normal_model_config import NormalModelConfig
from taccel_lab.signals.normals import rotate_from_z, rotate_to_z

CONFIG = NormalModelConfig(48, 36, scales_px=(1.0, 3.0), slope_scales_px=(3.0,), members=3)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def random_model(config: NormalModelConfig = CONFIG, seed: int = 0) -> NormalModel:
    rng = np.random.default_rng(seed)
    return NormalModel(
        config, {k: rng.normal(0, 0.3, shape) for k, shape in expected_shapes(config).items()}
    )


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


@given(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4), st.integers(0, 99))
def test_rotation_from_z_is_one_and_is_undone(p: float, q: float, seed: int) -> None:
    rest = unit(np.array([p, q, 1.0]))
    assert rotate_from_z(np.array([0.0, 0.0, 1.0]), rest) == pytest.approx(rest)
    vector = np.random.default_rng(seed).normal(size=3)
    turned = rotate_from_z(vector, rest)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(vector))
    assert rotate_to_z(turned, rest) == pytest.approx(vector)


@given(st.floats(0, 1.4), st.floats(-3.2, 3.2))
def test_tilt_is_the_angle_of_the_normal(angle: float, direction: float) -> None:
    tilt = angle * np.array([np.cos(direction), np.sin(direction)])
    normal = relative_normals(tilt)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert np.arctan2(np.hypot(normal[0], normal[1]), normal[2]) == pytest.approx(angle, abs=1e-9)


def test_the_background_reads_as_rest_exactly() -> None:
    model = random_model()
    background = np.random.default_rng(1).uniform(0, 255, (36, 48, 3)).astype(np.float32)
    found = model.predict(background, background)
    assert np.array_equal(found.tilt_rad, np.zeros((36, 48, 2)))
    assert np.array_equal(found.slopes(), np.zeros((36, 48, 2)))
    assert (found.sigma_deg > 0).all()
    rest = unit(np.array([0.3, -0.2, 1.0])) * np.ones((36, 48, 1))
    curved = model.predict(background, background, rest_normals=rest)
    assert curved.normals == pytest.approx(rest)


def test_poisoned_masked_pixels_have_no_effect() -> None:
    model = random_model()
    rng = np.random.default_rng(2)
    background = rng.uniform(0, 255, (36, 48, 3)).astype(np.float32)
    image = background + rng.normal(0, 20, background.shape).astype(np.float32)
    mask = np.ones((36, 48), dtype=bool)
    mask[10:20, 15:30] = False
    poisoned = image.copy()
    poisoned[~mask] = 1e4
    clean, dirty = (model.predict(i, background, mask=mask) for i in (image, poisoned))
    assert np.array_equal(clean.normals, dirty.normals)
    assert np.array_equal(clean.sigma_deg, dirty.sigma_deg)
    assert np.array_equal(clean.tilt_rad[~mask], np.zeros((int((~mask).sum()), 2)))
    assert not np.array_equal(model.predict(poisoned, background).normals, clean.normals)


def test_features_follow_a_zoomed_picture() -> None:
    """A pattern half as large, at scales half as wide, has the same features."""

    def picture(zoom: float, size: int) -> np.ndarray:
        v, u = (np.mgrid[:size, :size] - (size - 1) / 2) * zoom
        return np.stack([40 * np.exp(-(u**2 + v**2) / 900), u, 0 * v], -1).astype(np.float32)

    def features(change: np.ndarray, zoom: float) -> np.ndarray:
        size = len(change)
        return local_features(change, (2.0, 6.0), (6.0,), place=pixel_place(size, size), zoom=zoom)[
            size // 2 + 0, size // 2, :-2
        ]

    large, small = features(picture(1.0, 161), 1.0), features(picture(2.0, 161), 0.5)
    assert small == pytest.approx(large, abs=0.02)
    assert np.abs(features(picture(2.0, 161), 1.0) - large).max() > 0.1


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(InputError, match="image has shape"):
        random_model().predict(np.zeros((36, 47, 3)), np.zeros((36, 48, 3)))


def test_color_change_of_masked_pixels_is_zero() -> None:
    mask = np.array([[True, False]])
    change = color_change(np.full((1, 2, 3), 9, np.uint8), np.zeros((1, 2, 3)), mask)
    assert change.tolist() == [[[9.0] * 3, [0.0] * 3]]


def test_features_of_single_pixels_are_those_of_the_picture() -> None:
    rng = np.random.default_rng(3)
    change, background = rng.normal(size=(2, 36, 48, 3)).astype(np.float32)
    config = NormalModelConfig(48, 36, background=True, position_bands=2)
    picked = rng.permutation(36 * 48)[:70]
    whole = config.image_features(change, background).reshape(-1, config.input_count)
    np.testing.assert_array_equal(
        config.image_features(change, background, picked=picked), whole[picked]
    )


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_the_answers_are_those_of_the_model(activation: str) -> None:
    config = ColorModelConfig(width_px=40, height_px=30, hidden=(16, 8), activation=activation)
    rng = np.random.default_rng(1)
    shapes = color_shapes(config)
    model = ColorModel(config, {n: rng.normal(0, s[-1] ** -0.5, s) for n, s in shapes.items()})
    pixels = rng.integers(40 * 30, size=50)
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    upright, depth = np.tile([0.0, 0.0, 1.0], (50, 1)), rng.normal(size=50)
    uv = pixel_uv(config, pixels)
    pressed, still = (
        forward(model.weights, stack_inputs(config, uv, n, d), activation)
        for n, d in ((normals, depth), (upright, np.zeros(50)))
    )
    expected = model.predict_pixels(pixels, normals, depth, upright)
    np.testing.assert_allclose(config.output_scale * (pressed - still), expected, atol=1e-4)
