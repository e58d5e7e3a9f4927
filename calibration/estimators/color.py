# SPDX-License-Identifier: Apache-2.0
"""Fit the colour model to captures: surface of each press in, weights with their residuals out.

Pixels are drawn from the contact disc, the ring around it and the untouched rest. The loss is
Huber's in levels: nearly L1, which is what the images are scored by, and smooth at zero.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.capture.captures import ContactCircle
from calibration.estimators.background import Drift, average_background, fit_drift
from calibration.surfaces.types import PressSurface
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.color_model import (
    INPUT_NAMES,
    ColorModel,
    ColorModelConfig,
    color_change,
    expected_shapes,
    layer_tensors,
    pixel_uv,
    stack_inputs,
)

Progress = Callable[[int, int, float], None]
"""Called with (steps done, steps in all, loss)."""


@dataclass(frozen=True)
class ColorFitOptions:
    """Settings of the fit; the defaults take under a minute on one CPU thread."""

    inputs: tuple[str, ...] = INPUT_NAMES
    hidden: tuple[int, ...] = (64, 64, 64)
    steps: int = 2000
    batch_pixels: int = 4096
    learning_rate: float = 4e-3
    huber_levels: float = 2.0
    disc_pixels: int = 6000
    """Pixels drawn per frame within 1.3 contact radii."""
    ring_pixels: int = 4000
    """Pixels drawn per frame between 1.3 and 2.5 contact radii."""
    far_pixels: int = 1500
    """Pixels drawn per frame beyond 2.5 contact radii."""
    remove_drift: bool = False
    """Fit and remove an affine drift of the background in each training frame. Off, the background
    and the model settle on the mean light of the captures; on, they keep to the light of the one
    background image. Off scores better on Taxim's GelSight presses: L1 in the disc of left-out
    presses 2.2 against 3.2 levels when they alternate, 2.2 to 2.8 against 3.3 to 3.8 when a block
    of 12 neighbours is left out."""
    average_background: bool = True
    """Average the background with the untouched parts of the training frames."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("steps", "batch_pixels", "disc_pixels", "ring_pixels", "far_pixels"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("learning_rate", "huber_levels"):
            if not 0 < getattr(self, name) < 1e3:
                raise InputError(f"{name} must be positive, got {getattr(self, name)}")


@dataclass(frozen=True)
class ColorFrame:
    """One training press: what the camera saw and the surface the simulation gave."""

    name: str
    image: np.ndarray
    """RGB levels, shape [height_px, width_px, 3]."""
    circle: ContactCircle
    surface: PressSurface
    sha256: str = ""


@dataclass(frozen=True)
class ColorFit:
    """A fitted colour model with what is known about its quality."""

    model: ColorModel
    background: np.ndarray
    """Background to render on, RGB levels, float32, shape [height_px, width_px, 3]."""
    loss_curve: list[tuple[int, float]]
    """(step, Huber loss in levels) every 25 steps."""
    disc_l1_train: dict[str, float]
    """L1 inside each training press's contact disc, drift removed [levels]."""
    drifts: dict[str, Drift]
    options: ColorFitOptions
    seconds: float
    inputs: dict[str, str] = field(default_factory=dict)
    """SHA-256 of the training images by name."""


def fit_color_model(
    frames: Sequence[ColorFrame],
    background: np.ndarray,
    grid: PixelGrid,
    options: ColorFitOptions | None = None,
    *,
    mask: np.ndarray | None = None,
    progress: Progress | None = None,
) -> ColorFit:
    """Fit the colour model to ``frames``.

    ``background`` is the untouched sensor, RGB levels, shape [height_px, width_px, 3]; pixels
    where ``mask`` is false are never used. Deterministic for a seed on one thread.
    """
    options = options or ColorFitOptions()
    started = time.perf_counter()
    if not frames:
        raise InputError("the colour fit needs at least one press")
    drifts = {frame.name: _drift(frame, background, grid, mask, options) for frame in frames}
    rest_image = background.astype(np.float32)
    if options.average_background:
        rest_image = average_background(
            background,
            [frame.image for frame in frames],
            [frame.circle for frame in frames],
            [drifts[frame.name] for frame in frames],
            grid,
        )
        if mask is not None:
            rest_image = np.where(mask[..., None], rest_image, background.astype(np.float32))
    samples = _draw_samples(frames, rest_image, drifts, grid, mask, options)
    model, curve = _train(samples, grid, options, progress)
    residuals = {
        frame.name: _disc_l1(model, frame, rest_image, drifts[frame.name], grid, mask)
        for frame in frames
    }
    return ColorFit(
        model=model,
        background=rest_image,
        loss_curve=curve,
        disc_l1_train=residuals,
        drifts=drifts,
        options=options,
        seconds=time.perf_counter() - started,
        inputs={frame.name: frame.sha256 for frame in frames if frame.sha256},
    )


def cross_validate(
    frames: Sequence[ColorFrame],
    background: np.ndarray,
    grid: PixelGrid,
    options: ColorFitOptions | None = None,
    *,
    folds: int = 3,
    mask: np.ndarray | None = None,
) -> dict[str, float]:
    """L1 in the contact disc [levels] of each press, by a model that was fitted without it.

    ``folds`` shorter fits (a third of the steps); fold k leaves out every press whose index
    modulo ``folds`` is k.
    """
    options = options or ColorFitOptions()
    if not 2 <= folds <= len(frames):
        raise InputError(f"folds must lie in 2..{len(frames)} (the number of presses), got {folds}")
    options = replace(options, steps=max(1, options.steps // 3))
    left_out: dict[str, float] = {}
    for k in range(folds):
        kept = [frame for i, frame in enumerate(frames) if i % folds != k]
        fit = fit_color_model(kept, background, grid, options, mask=mask)
        for frame in frames[k::folds]:
            drift = _drift(frame, background, grid, mask, options)
            left_out[frame.name] = _disc_l1(fit.model, frame, fit.background, drift, grid, mask)
    return {frame.name: left_out[frame.name] for frame in frames}


@dataclass(frozen=True)
class _Samples:
    uv: np.ndarray
    normals: np.ndarray
    rest_normals: np.ndarray
    displacement_mm: np.ndarray
    change: np.ndarray
    """Captured minus background [levels], shape [n, 3]."""


def _drift(
    frame: ColorFrame,
    background: np.ndarray,
    grid: PixelGrid,
    mask: np.ndarray | None,
    options: ColorFitOptions,
) -> Drift:
    if not options.remove_drift:
        return Drift(np.ones(3), np.zeros(3))
    return fit_drift(frame.image, background, frame.circle, grid, mask)


def _draw_samples(
    frames: Sequence[ColorFrame],
    rest_image: np.ndarray,
    drifts: dict[str, Drift],
    grid: PixelGrid,
    mask: np.ndarray | None,
    options: ColorFitOptions,
) -> _Samples:
    rng = np.random.default_rng(options.seed)
    config = ColorModelConfig(grid.width_px, grid.height_px)
    parts: list[tuple[np.ndarray, ...]] = []
    for frame in frames:
        idx = _draw_pixels(frame, grid, mask, options, rng)
        surface = frame.surface
        image = drifts[frame.name].remove(frame.image.reshape(-1, 3)[idx].astype(np.float64))
        parts.append(
            (
                pixel_uv(config, idx),
                surface.normals.reshape(-1, 3)[idx],
                surface.rest_normals.reshape(-1, 3)[idx],
                surface.displacement_mm().reshape(-1)[idx],
                image - rest_image.reshape(-1, 3)[idx],
            )
        )
    return _Samples(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _draw_pixels(
    frame: ColorFrame,
    grid: PixelGrid,
    mask: np.ndarray | None,
    options: ColorFitOptions,
    rng: np.random.Generator,
) -> np.ndarray:
    distance = frame.circle.distance_px(grid) / frame.circle.radius_px
    usable = np.ones_like(distance, dtype=bool) if mask is None else mask
    picked = []
    for low, high, count in (
        (0.0, 1.3, options.disc_pixels),
        (1.3, 2.5, options.ring_pixels),
        (2.5, np.inf, options.far_pixels),
    ):
        region = np.flatnonzero(usable & (distance >= low) & (distance < high))
        picked.append(rng.permutation(region)[:count])
    if len(picked[0]) == 0:
        raise InputError(f"{frame.name}: every pixel of the contact is masked")
    return np.concatenate(picked)


def _train(
    samples: _Samples, grid: PixelGrid, options: ColorFitOptions, progress: Progress | None
) -> tuple[ColorModel, list[tuple[int, float]]]:
    with _one_thread():
        return _train_on_thread(samples, grid, options, progress)


def _train_on_thread(
    samples: _Samples, grid: PixelGrid, options: ColorFitOptions, progress: Progress | None
) -> tuple[ColorModel, list[tuple[int, float]]]:
    import torch

    plain = ColorModelConfig(
        grid.width_px,
        grid.height_px,
        inputs=options.inputs,
        hidden=options.hidden,
        input_mean=(0.0,) * len(options.inputs),
        input_scale=(1.0,) * len(options.inputs),
    )
    raw = stack_inputs(plain, samples.uv, samples.normals, samples.displacement_mm)
    config = replace(
        plain,
        input_mean=tuple(float(x) for x in raw.mean(axis=0)),
        input_scale=tuple(float(x) for x in np.maximum(raw.std(axis=0), 1e-3)),
    )
    pressed = torch.from_numpy(
        stack_inputs(config, samples.uv, samples.normals, samples.displacement_mm)
    )
    at_rest = torch.from_numpy(
        stack_inputs(config, samples.uv, samples.rest_normals, np.zeros(len(samples.uv)))
    )
    wanted = torch.from_numpy(samples.change.astype(np.float32))
    generator = torch.Generator().manual_seed(options.seed)
    weights = _initial_weights(config, generator)
    layers = [
        (weight.requires_grad_(), bias.requires_grad_())
        for weight, bias in layer_tensors(config, weights)
    ]
    optimizer = torch.optim.Adam(
        [tensor for layer in layers for tensor in layer], lr=options.learning_rate
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, options.learning_rate, total_steps=options.steps + 1, pct_start=0.1
    )
    curve: list[tuple[int, float]] = []
    for step in range(1, options.steps + 1):
        batch = torch.randint(len(wanted), (options.batch_pixels,), generator=generator)
        change = color_change(config, layers, pressed[batch], at_rest[batch])
        loss = torch.nn.functional.huber_loss(change, wanted[batch], delta=options.huber_levels)
        # Huber's slope beyond delta is delta; dividing reads as mean absolute error in levels.
        loss = loss / options.huber_levels
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % 25 == 0 or step == options.steps:
            curve.append((step, float(loss.detach())))
            if progress is not None:
                progress(step, options.steps, curve[-1][1])
    fitted = {
        name: tensor.detach().numpy()
        for name, tensor in zip(
            expected_shapes(config), (t for layer in layers for t in layer), strict=True
        )
    }
    return ColorModel(config, fitted), curve


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run torch on one thread: batches are small, and sums then do not depend on the machine."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _initial_weights(config: ColorModelConfig, generator: object) -> dict[str, np.ndarray]:
    """Uniform in +-1/sqrt(inputs), as torch.nn.Linear draws them."""
    import torch

    assert isinstance(generator, torch.Generator)
    weights = {}
    for name, shape in expected_shapes(config).items():
        fan_in = shape[1] if len(shape) == 2 else weights[name.replace("bias", "weight")].shape[1]
        bound = 1.0 / np.sqrt(fan_in)
        weights[name] = ((torch.rand(shape, generator=generator) * 2 - 1) * bound).numpy()
    return weights


def _disc_l1(
    model: ColorModel,
    frame: ColorFrame,
    rest_image: np.ndarray,
    drift: Drift,
    grid: PixelGrid,
    mask: np.ndarray | None,
) -> float:
    disc = frame.circle.distance_px(grid) <= frame.circle.radius_px
    if mask is not None:
        disc &= mask
    surface = frame.surface
    change = model.predict_pixels(
        np.flatnonzero(disc),
        surface.normals[disc],
        surface.displacement_mm()[disc],
        surface.rest_normals[disc],
    )
    rendered = drift.apply(np.clip(rest_image[disc] + change, 0.0, 255.0))
    return float(np.abs(rendered - frame.image[disc]).mean())
