# SPDX-License-Identifier: Apache-2.0
"""Gradient descent of the colour network on drawn pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import ColorSamples
from taccel_lab.calibration.response.training import (
    arrays_of,
    descend,
    initial_weights,
    one_thread,
    trainable,
)
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig, stack_inputs
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.color_model import ColorModel, color_change, layer_tensors

TASK = "fitting the colour model"
CURVE_EVERY = 25
WARM_UP = 0.1
"""Share of the steps in which the learning rate rises."""


@dataclass(frozen=True)
class TrainedColors:
    """Weights and how they came about."""

    model: ColorModel
    curve: list[tuple[int, float]]
    """(step, loss in levels) every 25 steps."""


def train(
    samples: ColorSamples,
    grid: PixelGrid,
    options: ColorFitOptions,
    *,
    progress: Progress = silent,
) -> TrainedColors:
    """Fit the network to ``samples``. Deterministic for a seed: it runs on one thread."""
    config = _scaled_config(samples, grid, options)
    pressed, at_rest, wanted = _tensors(config, samples)
    generator = torch.Generator().manual_seed(options.seed)
    shapes = config.weight_shapes()
    weights = initial_weights(shapes, generator)
    layers = trainable(layer_tensors(config, weights))
    curve: list[tuple[int, float]] = []

    def batch_loss() -> torch.Tensor:
        batch = torch.randint(len(wanted), (options.batch_pixels,), generator=generator)
        change = color_change(config, layers, pressed[batch], at_rest[batch])
        delta = options.huber_levels
        # Huber's slope beyond delta is delta; dividing reads as mean absolute error in levels.
        return torch.nn.functional.huber_loss(change, wanted[batch], delta=delta) / delta

    def after_step(step: int, loss: torch.Tensor) -> None:
        if step % CURVE_EVERY == 0 or step == options.steps:
            curve.append((step, float(loss.detach())))
            progress(TASK, step, options.steps)

    with one_thread():
        descend(
            layers, batch_loss, after_step,
            steps=options.steps, learning_rate=options.learning_rate, warm_up=WARM_UP,
            # Six inputs as they are: with the first layer's alike, places are learned by heart.
            matrices=[weight for weight, _ in layers[1:-1]],
        )  # fmt: skip
        return TrainedColors(ColorModel(config, arrays_of(shapes, layers)), curve)


def _scaled_config(
    samples: ColorSamples, grid: PixelGrid, options: ColorFitOptions
) -> ColorModelConfig:
    plain = ColorModelConfig(
        grid.width_px,
        grid.height_px,
        inputs=options.inputs,
        hidden=options.hidden,
        input_mean=(0.0,) * len(options.inputs),
        input_scale=(1.0,) * len(options.inputs),
    )
    raw = stack_inputs(plain, samples.uv, samples.normals, samples.displacement_mm)
    return replace(
        plain,
        input_mean=tuple(float(x) for x in raw.mean(axis=0)),
        input_scale=tuple(float(x) for x in np.maximum(raw.std(axis=0), 1e-3)),
        position_bands=options.position_bands,
    )


def _tensors(
    config: ColorModelConfig, samples: ColorSamples
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Inputs under the press and at rest, and the change that is wanted [levels]."""
    uv = samples.uv
    return (
        torch.from_numpy(stack_inputs(config, uv, samples.normals, samples.displacement_mm)),
        torch.from_numpy(stack_inputs(config, uv, samples.rest_normals, np.zeros(len(uv)))),
        torch.from_numpy(samples.change.astype(np.float32)),
    )
