# SPDX-License-Identifier: Apache-2.0
"""Network from slope to colour, fitted to pixels of presses whose surfaces are known."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from taccel_lab.calibration.color.options import ColorFitOptions
from taccel_lab.calibration.response.frame import (
    CaptureScene,
    PressFrame,
    draw_pixels,
    light_beside,
)
from taccel_lab.calibration.response.training import (
    arrays_of,
    descend,
    initial_weights,
    one_thread,
    trainable,
)
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig, pixel_uv, stack_inputs
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.light import LightDrift
from taccel_lab.signals.color_model import ColorModel, color_change
from taccel_lab.signals.tensors import layer_tensors

TASK = "fitting the colour model"
CURVE_EVERY = 25
WARM_UP = 0.1
"""Share of the steps in which the learning rate rises."""


@dataclass(frozen=True)
class ColorSamples:
    """Pixels drawn from presses."""

    uv: np.ndarray
    normals: np.ndarray
    rest_normals: np.ndarray
    displacement_mm: np.ndarray
    change: np.ndarray
    """Captured minus background [levels], shape [n, 3]."""


@dataclass(frozen=True)
class ColorFit:
    """A fitted colour model with what is known about its quality."""

    model: ColorModel
    background: np.ndarray
    """Background to render on, RGB levels, float32, shape [height_px, width_px, 3]."""
    loss_curve: list[tuple[int, float]]
    """(step, loss in levels) every 25 steps."""
    disc_l1_train: dict[str, float]
    """L1 inside each training press's contact disc, drift removed [levels]."""
    drifts: dict[str, LightDrift]
    options: ColorFitOptions
    seconds: float
    inputs: dict[str, str] = field(default_factory=dict)
    """SHA-256 of the training images by name."""


def fit_color_model(
    frames: Sequence[PressFrame],
    scene: CaptureScene,
    options: ColorFitOptions = ColorFitOptions(),
    progress: Progress = silent,
) -> ColorFit:
    """Fit the colour model to ``frames``; deterministic for a seed on one thread.

    Raises:
        InputError: No press, or one whose contact is masked.
    """
    started = time.perf_counter()
    if not frames:
        raise InputError("the colour fit needs at least one press")
    drifts = {frame.name: light_beside(frame.image, scene, frame.circle) for frame in frames}
    samples = draw_samples(frames, scene, drifts, options)
    model, curve = train(samples, scene.grid, options, progress)
    model = ColorModel(model.config, model.weights, _steepest_deg(samples))
    return ColorFit(
        model=model,
        background=scene.background,
        loss_curve=curve,
        disc_l1_train={f.name: _disc_l1(model, f, scene, drifts[f.name]) for f in frames},
        drifts=drifts,
        options=options,
        seconds=time.perf_counter() - started,
        inputs={frame.name: frame.sha256 for frame in frames if frame.sha256},
    )


def draw_samples(
    frames: Sequence[PressFrame],
    scene: CaptureScene,
    drifts: dict[str, LightDrift],
    options: ColorFitOptions,
) -> ColorSamples:
    """Pixels of the frames: the contact disc, the ring around it and the untouched rest."""
    rng, grid = np.random.default_rng(options.seed), scene.grid
    rest_image, size = scene.background.reshape(-1, 3), (grid.height_px, grid.width_px)
    parts = []
    for frame in frames:
        idx, surface = draw_pixels(frame, scene, options.rings, rng), frame.surface
        levels = frame.image.reshape(-1, 3)[idx].astype(np.float64)
        parts.append(
            (
                pixel_uv(ColorModelConfig(grid.width_px, grid.height_px), idx),
                surface.normals.reshape(-1, 3)[idx],
                surface.rest_normals.reshape(-1, 3)[idx],
                surface.displacement_mm().reshape(-1)[idx],
                drifts[frame.name].at(idx, *size).remove(levels) - rest_image[idx],
            )
        )
    return ColorSamples(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def train(
    samples: ColorSamples, grid: PixelGrid, options: ColorFitOptions, progress: Progress = silent
) -> tuple[ColorModel, list[tuple[int, float]]]:
    """The network fitted to ``samples``, and (step, loss in levels) every 25 steps.

    Deterministic for a seed: it runs on one thread.
    """
    config = _scaled_config(samples, grid, options)
    uv = samples.uv
    pressed, at_rest, wanted = (
        torch.from_numpy(array)
        for array in (
            stack_inputs(config, uv, samples.normals, samples.displacement_mm),
            stack_inputs(config, uv, samples.rest_normals, np.zeros(len(uv))),
            samples.change.astype(np.float32),
        )
    )
    generator = torch.Generator().manual_seed(options.seed)
    shapes = config.weight_shapes()
    layers = trainable(layer_tensors(initial_weights(shapes, generator)))
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
        return ColorModel(config, arrays_of(shapes, layers)), curve


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


def _steepest_deg(samples: ColorSamples) -> float:
    """Tilt of the steepest normals that a fit is shown: one in 10,000 leans further."""
    return math.degrees(math.acos(np.clip(np.quantile(samples.normals[:, 2], 1e-4), 0.0, 1.0)))


def _disc_l1(model: ColorModel, frame: PressFrame, scene: CaptureScene, drift: LightDrift) -> float:
    """L1 of a press inside its contact circle, its drift applied to the render [levels]."""
    disc, surface = scene.inside(frame.circle), frame.surface
    pixels = np.flatnonzero(disc)
    change = model.predict_pixels(
        pixels, surface.normals[disc], surface.displacement_mm()[disc], surface.rest_normals[disc]
    )
    light = drift.at(pixels, scene.grid.height_px, scene.grid.width_px)
    rendered = light.apply(np.clip(scene.background[disc] + change, 0.0, 255.0))
    return float(np.abs(rendered - frame.image[disc]).mean())
