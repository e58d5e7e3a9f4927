# SPDX-License-Identifier: Apache-2.0
"""Gradient descent of the colour network on drawn pixels, and on crops for the SSIM loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.color.frames import Samples
from taccel_lab.calibration.color.options import ColorFitOptions, Progress
from taccel_lab.calibration.one_thread import one_thread
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.color_model import (
    ColorModel,
    ColorModelConfig,
    color_change,
    expected_shapes,
    layer_tensors,
    stack_inputs,
)

if TYPE_CHECKING:
    import torch

CURVE_EVERY = 25
CHECK_EVERY = 100
"""Steps between looks at the validation presses."""
SSIM_WINDOW_PX = 11


@dataclass(frozen=True)
class Crop:
    """A rectangle of one press, for losses that look at neighbouring pixels."""

    samples: Samples
    shape: tuple[int, int]
    """Rows and columns; the samples run along rows."""


@dataclass(frozen=True)
class Trained:
    """Weights and how they came about."""

    model: ColorModel
    curve: list[tuple[int, float]]
    """(step, loss in levels) every 25 steps."""
    validation_curve: list[tuple[int, float]]
    """(step, loss in levels on the validation presses) every 100 steps."""
    step: int
    """Step that the weights are of."""


def train(
    samples: Samples,
    grid: PixelGrid,
    options: ColorFitOptions,
    *,
    validation: Samples | None = None,
    crops: Sequence[Crop] = (),
    start: ColorModel | None = None,
    progress: Progress | None = None,
) -> Trained:
    """Fit the network to ``samples``; with ``validation``, take the weights that are best there.

    ``crops`` serve the loss ``ssim``. ``start`` is a model to go on from; its shape and the scales
    of its inputs stay. Deterministic for a seed: it runs on one thread.
    """
    with one_thread():
        return _Trainer(samples, grid, options, validation, crops, start).run(progress)


class _Trainer:
    def __init__(
        self,
        samples: Samples,
        grid: PixelGrid,
        options: ColorFitOptions,
        validation: Samples | None,
        crops: Sequence[Crop],
        start: ColorModel | None,
    ) -> None:
        import torch

        self.options = options
        self.config = _scaled_config(samples, grid, options) if start is None else start.config
        self._pixels = _tensors(self.config, samples)
        self._validation = None if validation is None else _tensors(self.config, validation)
        self._crops = [(_tensors(self.config, crop.samples), crop.shape) for crop in crops]
        self._generator = torch.Generator().manual_seed(options.seed)
        weights = _initial_weights(self.config, self._generator)
        if start is not None:
            weights = {name: value.copy() for name, value in start.weights.items()}
        self._layers = [
            (weight.requires_grad_(), bias.requires_grad_())
            for weight, bias in layer_tensors(self.config, weights)
        ]

    def run(self, progress: Progress | None) -> Trained:
        import torch

        options = self.options
        tensors = [tensor for layer in self._layers for tensor in layer]
        optimizer = torch.optim.Adam(tensors, lr=options.learning_rate, fused=True)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer, options.learning_rate, total_steps=options.steps + 1, pct_start=0.1
        )
        curve: list[tuple[int, float]] = []
        checks: list[tuple[int, float]] = []
        best, best_step = self._weights(), 0
        for step in range(1, options.steps + 1):
            loss = self._loss()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            if step % CURVE_EVERY == 0 or step == options.steps:
                curve.append((step, float(loss.detach())))
                if progress is not None:
                    progress(step, options.steps, curve[-1][1])
            if self._validation is not None and (step % CHECK_EVERY == 0 or step == options.steps):
                checks.append((step, self._validation_loss()))
                if checks[-1][1] <= min(value for _, value in checks):
                    best, best_step = self._weights(), step
                elif step - best_step >= options.patience * CHECK_EVERY:
                    break
        if self._validation is None:
            best, best_step = self._weights(), options.steps
        return Trained(ColorModel(self.config, best), curve, checks, best_step)

    def _loss(self) -> torch.Tensor:
        import torch

        pressed, at_rest, wanted = self._pixels
        batch = torch.randint(len(wanted), (self.options.batch_pixels,), generator=self._generator)
        change = color_change(self.config, self._layers, pressed[batch], at_rest[batch])
        loss = self._pixel_loss(change, wanted[batch])
        if self.options.loss == "ssim" and self._crops:
            loss = loss + self.options.ssim_weight * self._dissimilarity()
        return loss

    def _pixel_loss(self, change: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        import torch

        if self.options.loss == "l1":
            return torch.nn.functional.l1_loss(change, wanted)
        delta = self.options.huber_levels
        # Huber's slope beyond delta is delta; dividing reads as mean absolute error in levels.
        return torch.nn.functional.huber_loss(change, wanted, delta=delta) / delta

    def _dissimilarity(self) -> torch.Tensor:
        """(1 - SSIM) / 2 of one crop, drawn at random."""
        import kornia.losses
        import torch

        which = int(torch.randint(len(self._crops), (1,), generator=self._generator))
        (pressed, at_rest, wanted), shape = self._crops[which]
        change = color_change(self.config, self._layers, pressed, at_rest)
        images = [x.reshape(1, *shape, 3).permute(0, 3, 1, 2) for x in (change, wanted)]
        # SSIM takes levels from 0 up, with which its constants are scaled; changes are +-128.
        return kornia.losses.ssim_loss(
            images[0] + 128.0, images[1] + 128.0, SSIM_WINDOW_PX, max_val=255.0
        )

    def _validation_loss(self) -> float:
        import torch

        assert self._validation is not None
        pressed, at_rest, wanted = self._validation
        with torch.no_grad():
            change = color_change(self.config, self._layers, pressed, at_rest)
            return float(self._pixel_loss(change, wanted))

    def _weights(self) -> dict[str, np.ndarray]:
        return {
            name: tensor.detach().numpy().copy()
            for name, tensor in zip(
                expected_shapes(self.config), (t for layer in self._layers for t in layer),
                strict=True,
            )
        }  # fmt: skip


def _scaled_config(samples: Samples, grid: PixelGrid, options: ColorFitOptions) -> ColorModelConfig:
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
    config: ColorModelConfig, samples: Samples
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Inputs under the press and at rest, and the change that is wanted [levels]."""
    import torch

    uv = samples.uv
    return (
        torch.from_numpy(stack_inputs(config, uv, samples.normals, samples.displacement_mm)),
        torch.from_numpy(stack_inputs(config, uv, samples.rest_normals, np.zeros(len(uv)))),
        torch.from_numpy(samples.change.astype(np.float32)),
    )


def _initial_weights(config: ColorModelConfig, generator: torch.Generator) -> dict[str, np.ndarray]:
    """Uniform in +-1/sqrt(inputs), as torch.nn.Linear draws them."""
    import torch

    weights = {}
    for name, shape in expected_shapes(config).items():
        fan_in = shape[1] if len(shape) == 2 else weights[name.replace("bias", "weight")].shape[1]
        bound = 1.0 / np.sqrt(fan_in)
        weights[name] = ((torch.rand(shape, generator=generator) * 2 - 1) * bound).numpy()
    return weights
