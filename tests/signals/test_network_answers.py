# SPDX-License-Identifier: Apache-2.0
"""Networks whose answers no sensor can show are refused, and only those."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.signals.color_model import (
    ACTIVATIONS,
    ColorModel,
    ColorModelConfig,
    pixel_uv,
    stack_inputs,
)
from taccel_lab.signals.color_model import expected_shapes as color_shapes
from taccel_lab.signals.force_settings import ForceModelConfig
from taccel_lab.signals.network_answers import forward, require_answers
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.normal_model import expected_shapes as normal_shapes
from taccel_lab.signals.normal_model_config import NormalModelConfig

COLORS = ColorModelConfig(width_px=40, height_px=30, hidden=(16, 8))
NORMALS = NormalModelConfig(width_px=40, height_px=30, members=3, hidden=(16, 8))


def weights_of(shapes: dict[str, tuple[int, ...]], seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {n: rng.normal(0, s[-1] ** -0.5, s).astype(np.float32) for n, s in shapes.items()}


def scaled(weights: dict[str, np.ndarray], layer: int, factor: float) -> dict[str, np.ndarray]:
    return {
        n: v * np.float32(factor if n.startswith(f"layer{layer}") else 1)
        for n, v in weights.items()
    }


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_the_answers_are_those_of_the_model(activation: str) -> None:
    config = dataclasses.replace(COLORS, activation=activation)
    model = ColorModel(config, weights_of(color_shapes(config)))
    rng = np.random.default_rng(1)
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


@pytest.mark.parametrize("seed", range(3))
def test_a_color_model_that_is_scaled_is_refused(seed: int) -> None:
    weights = weights_of(color_shapes(COLORS), seed)
    ColorModel(COLORS, weights).require_levels()
    wrong = [
        ColorModel(COLORS, scaled(weights, 2, 100)),
        ColorModel(dataclasses.replace(COLORS, output_scale=3200.0), weights),
        ColorModel(COLORS, scaled(weights, 2, 1e38)),
    ]
    for model in wrong:
        with pytest.raises(InputError, match=r"color model answers up to .* levels, but a picture"):
            model.require_levels()


@pytest.mark.parametrize("seed", range(3))
def test_a_normal_model_that_is_scaled_is_refused(seed: int) -> None:
    weights = weights_of(normal_shapes(NORMALS), seed)
    NormalModel(NORMALS, weights).require_angles()
    with pytest.raises(InputError, match=r"normal model answers up to .* degrees, but a tilt has"):
        NormalModel(NORMALS, scaled(weights, 2, 100)).require_angles()


def test_answers_that_are_no_numbers_are_too_large() -> None:
    require_answers("it", np.full(100, 1.0), 2.0, "N", "more is none")
    with pytest.raises(InputError, match="it answers up to inf N, but more is none"):
        require_answers("it", np.full(100, np.nan), 2.0, "N", "more is none")


@pytest.mark.parametrize(
    ("name", "values"),
    [("target_scale", (1000.0, 1, 1, 1, 1, 1, 1)), ("target_scale", (1, 1, 1, 1, 1, 1, 1e5)),
     ("patch_scale_n", (1, 1, 1e-5)), ("sigma_factor", (1, 1e3, 1, 1, 1, 1, 1)),
     ("most", (5e3, 1, 1, 1))],
)  # fmt: skip
def test_force_models_have_scales_of_gels(name: str, values: tuple[float, ...]) -> None:
    config = ForceModelConfig(width_px=40, height_px=30, columns=2, rows=2)
    with pytest.raises(InputError, match=rf"force model.* ({name}|largest force)"):
        dataclasses.replace(config, **{name: values})
