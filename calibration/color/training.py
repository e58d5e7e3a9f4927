# SPDX-License-Identifier: Apache-2.0
"""Gradient descent of the colour network on drawn pixels, and on crops for the SSIM loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import Samples
from taccel_lab.calibration.training import (
    CHECK_EVERY,
    arrays_of,
    descend,
    initial_weights,
    one_thread,
    trainable,
)
from taccel_lab.geometry import PixelGrid
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.color_model import (
    ColorModel,
    ColorModelConfig,
    color_change,
    expected_shapes,
    layer_tensors,
    stack_inputs,
)

TASK = "fitting the colour model"
CURVE_EVERY = 25
WARM_UP = 0.1
"""Share of the steps in which the learning rate rises."""
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
    progress: Progress = silent,
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
        self.options = options
        self.config = _scaled_config(samples, grid, options) if start is None else start.config
        self._pixels = _tensors(self.config, samples)
        self._validation = None if validation is None else _tensors(self.config, validation)
        self._crops = [(_tensors(self.config, crop.samples), crop.shape) for crop in crops]
        self._generator = torch.Generator().manual_seed(options.seed)
        self._shapes = expected_shapes(self.config)
        weights = initial_weights(self._shapes, self._generator)
        if start is not None:
            weights = {name: value.copy() for name, value in start.weights.items()}
        self._layers = trainable(layer_tensors(self.config, weights))

    def run(self, progress: Progress) -> Trained:
        options = self.options
        curve: list[tuple[int, float]] = []
        checks: list[tuple[int, float]] = []
        best, best_step = self._weights(), 0

        def after_step(step: int, loss: torch.Tensor) -> bool:
            nonlocal best, best_step
            if step % CURVE_EVERY == 0 or step == options.steps:
                curve.append((step, float(loss.detach())))
                progress(TASK, step, options.steps)
            if self._validation is not None and (step % CHECK_EVERY == 0 or step == options.steps):
                checks.append((step, self._validation_loss()))
                if checks[-1][1] <= min(value for _, value in checks):
                    best, best_step = self._weights(), step
                return step - best_step < options.patience * CHECK_EVERY
            return True

        descend(
            self._layers, self._loss, after_step,
            steps=options.steps, learning_rate=options.learning_rate, warm_up=WARM_UP,
        )  # fmt: skip
        if self._validation is None:
            best, best_step = self._weights(), options.steps
        return Trained(ColorModel(self.config, best), curve, checks, best_step)

    def _loss(self) -> torch.Tensor:
        pressed, at_rest, wanted = self._pixels
        batch = torch.randint(len(wanted), (self.options.batch_pixels,), generator=self._generator)
        change = color_change(self.config, self._layers, pressed[batch], at_rest[batch])
        loss = self._pixel_loss(change, wanted[batch])
        if self.options.loss == "ssim" and self._crops:
            loss = loss + self.options.ssim_weight * self._dissimilarity()
        return loss

    def _pixel_loss(self, change: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        if self.options.loss == "l1":
            return torch.nn.functional.l1_loss(change, wanted)
        delta = self.options.huber_levels
        # Huber's slope beyond delta is delta; dividing reads as mean absolute error in levels.
        return torch.nn.functional.huber_loss(change, wanted, delta=delta) / delta

    def _dissimilarity(self) -> torch.Tensor:
        """(1 - SSIM) / 2 of one crop, drawn at random."""
        import kornia.losses

        which = int(torch.randint(len(self._crops), (1,), generator=self._generator))
        (pressed, at_rest, wanted), shape = self._crops[which]
        change = color_change(self.config, self._layers, pressed, at_rest)
        images = [x.reshape(1, *shape, 3).permute(0, 3, 1, 2) for x in (change, wanted)]
        # SSIM takes levels from 0 up, with which its constants are scaled; changes are +-128.
        return kornia.losses.ssim_loss(
            images[0] + 128.0, images[1] + 128.0, SSIM_WINDOW_PX, max_val=255.0
        )

    def _validation_loss(self) -> float:
        assert self._validation is not None
        pressed, at_rest, wanted = self._validation
        with torch.no_grad():
            change = color_change(self.config, self._layers, pressed, at_rest)
            return float(self._pixel_loss(change, wanted))

    def _weights(self) -> dict[str, np.ndarray]:
        return arrays_of(self._shapes, self._layers)


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
    uv = samples.uv
    return (
        torch.from_numpy(stack_inputs(config, uv, samples.normals, samples.displacement_mm)),
        torch.from_numpy(stack_inputs(config, uv, samples.rest_normals, np.zeros(len(uv)))),
        torch.from_numpy(samples.change.astype(np.float32)),
    )
