# SPDX-License-Identifier: Apache-2.0
"""Positional encoding: its formula, and the same answer from every evaluator of the networks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.signals.color_model import ColorModel, ColorModelConfig, expected_shapes
from taccel_lab.signals.normal_features import feature_names, pixel_place
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.normal_model import expected_shapes as normal_shapes
from taccel_lab.signals.normal_model_config import NormalModelConfig
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.position_encoding import MAX_BANDS, band_names, encode_position
from taccel_lab.signals.tactile_image import DeviceColorModel
from tests.signals.host_colors import host_image
from tests.signals.tactile_cases import DEVICES, LEVELS

WIDTH, HEIGHT = 30, 22


def encoded_model(bands: int, hidden: tuple[int, ...] = (20, 16), seed: int = 0) -> ColorModel:
    config = ColorModelConfig(
        WIDTH, HEIGHT, hidden=hidden, position_bands=bands,
        input_mean=(0.0, 0.0, 0.0, 0.0, 0.95, -0.1), input_scale=(0.6, 0.6, 0.2, 0.2, 0.1, 0.2),
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    return ColorModel(
        config,
        {
            name: rng.normal(0, 1.2 / np.sqrt(shape[-1]), shape)
            for name, shape in expected_shapes(config).items()
        },
    )


@given(st.floats(-1, 1), st.floats(-1, 1), st.integers(0, MAX_BANDS))
def test_features_are_those_of_the_formula(u: float, v: float, bands: int) -> None:
    found = dict(
        zip(band_names(bands), encode_position(np.array([u, v]), bands).tolist(), strict=True)
    )
    assert len(found) == 4 * bands
    for k in range(bands):
        for axis, place in (("u", u), ("v", v)):
            assert found[f"sin_{axis}_{k}"] == pytest.approx(np.sin(2**k * np.pi * place))
            assert found[f"cos_{axis}_{k}"] == pytest.approx(np.cos(2**k * np.pi * place))


def test_the_network_gets_them_after_its_inputs_unscaled() -> None:
    model = encoded_model(2, hidden=(5,))
    assert model.weights["layer0.weight"].shape == (5, 6 + 8)
    idx, normal, depth = np.array([WIDTH + 4]), np.array([[0.3, -0.2, 0.9]]), np.array([-0.3])
    u, v = 2 * 4 / (WIDTH - 1) - 1, 2 * 1 / (HEIGHT - 1) - 1
    waves = []
    for f in (np.pi, 2 * np.pi):
        waves += [np.sin(f * u), np.sin(f * v), np.cos(f * u), np.cos(f * v)]

    def network(n: list[float], d: float) -> np.ndarray:
        raw = np.array([u, v, *n, d]) - model.config.input_mean
        x = np.array([*(raw / model.config.input_scale), *waves])
        x = model.weights["layer0.weight"] @ x + model.weights["layer0.bias"]
        return 32 * model.weights["layer1.weight"] @ (x / (1 + np.exp(-x)))

    expected = network([0.3, -0.2, 0.9], -0.3) - network([0.0, 0.0, 1.0], 0.0)
    found = model.predict_pixels(idx, normal, depth, np.array([[0.0, 0.0, 1.0]]))
    assert found[0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("bands", [0, 1, 4])
def test_device_images_are_those_of_the_model(bands: int, device: str) -> None:
    model = encoded_model(bands)
    rng = np.random.default_rng(1)
    rest = np.concatenate(
        [rng.normal(0, 0.05, (HEIGHT, WIDTH, 2)), np.zeros((HEIGHT, WIDTH, 1))], -1
    )
    samples = rest + rng.normal(0, 1, (2, HEIGHT, WIDTH, 3)) * [0.3, 0.3, 2e-4]
    samples[0, :5] = rest[:5]
    background = rng.uniform(60, 190, (HEIGHT, WIDTH, 3)).astype(np.float32)
    painter = DeviceColorModel(
        model, background, wp.array(rest.astype(np.float32), dtype=wp.vec3f, device=device)
    )
    levels = wp.empty((2, HEIGHT, WIDTH, 3), dtype=wp.float32, device=device)
    painter.render(
        wp.array(samples.astype(np.float32), dtype=wp.vec3f, device=device), None, levels
    )
    expected = np.stack(
        [
            host_image(
                model,
                background,
                normals_from_slopes(image[..., :2]),
                1e3 * (image[..., 2] - rest[..., 2]),
                normals_from_slopes(rest[..., :2]),
            )
            for image in samples
        ]
    )
    assert np.abs(expected - background).max() > 10
    assert np.abs(levels.numpy() - expected).max() < LEVELS[device]
    assert np.array_equal(levels.numpy()[0, :5], background[:5])


def test_settings_say_how_many_bands_and_refuse_too_many() -> None:
    config = encoded_model(3).config
    assert ColorModelConfig.from_dict(config.to_dict()) == config
    normals = NormalModelConfig(WIDTH, HEIGHT, position_bands=2)
    assert NormalModelConfig.from_dict(normals.to_dict()) == normals
    for bands in (-1, MAX_BANDS + 1):
        with pytest.raises(InputError, match=r"color model position_bands must lie in 0\.\.8"):
            dataclasses.replace(config, position_bands=bands)
        with pytest.raises(InputError, match=r"normal model position_bands must lie in 0\.\.8"):
            NormalModelConfig(WIDTH, HEIGHT, position_bands=bands)
    with pytest.raises(InputError, match="weights have shapes"):
        ColorModel(dataclasses.replace(config, position_bands=2), encoded_model(3).weights)


def test_the_normals_network_has_them_among_its_features() -> None:
    plain = feature_names((1.0,), (2.0,), True)
    assert feature_names((1.0,), (2.0,), True, 1) == (*plain, "sin_u_0", "sin_v_0", "cos_u_0",
                                                      "cos_v_0")  # fmt: skip
    place = pixel_place(WIDTH, HEIGHT, 2)
    assert place.shape == (HEIGHT, WIDTH, 10) and place.dtype == np.float32
    assert place[3, 7, 2:] == pytest.approx(encode_position(place[3, 7, :2], 2), abs=1e-6)
    config = NormalModelConfig(WIDTH, HEIGHT, position_bands=2, members=2, hidden=(8,))
    rng = np.random.default_rng(0)
    weights = {name: rng.normal(0, 0.3, shape) for name, shape in normal_shapes(config).items()}
    model = NormalModel(config, weights)
    background = np.full((HEIGHT, WIDTH, 3), 100.0)
    image = background + rng.normal(0, 20, background.shape)
    # Unchanged gel is at rest, and a band's weights have an effect elsewhere.
    assert not model.predict(background, background).tilt_rad.any()
    with_bands = model.predict(image, background).tilt_rad
    without = {**weights, "layer0.weight": weights["layer0.weight"].copy()}
    without["layer0.weight"][..., -8:] = 0.0
    model = NormalModel(config, without)
    assert np.abs(model.predict(image, background).tilt_rad - with_bands).max() > 1e-2
