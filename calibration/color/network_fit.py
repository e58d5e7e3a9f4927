# SPDX-License-Identifier: Apache-2.0
"""Fit the colour model to captures: surface of each press in, weights with their residuals out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from taccel_lab.calibration.color.evaluate import crop_slices
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import (
    ColorFrame,
    draw_samples,
    frame_drift,
    samples_at,
)
from taccel_lab.calibration.color.training import SSIM_WINDOW_PX, Crop, train
from taccel_lab.calibration.light.average import average_background
from taccel_lab.calibration.light.light import Light
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.color_model import ColorModel

CROP_PX = 64
"""Largest crop of the SSIM loss along either side."""


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
    drifts: dict[str, Light]
    options: ColorFitOptions
    seconds: float
    inputs: dict[str, str] = field(default_factory=dict)
    """SHA-256 of the training images by name."""
    validation_curve: list[tuple[int, float]] = field(default_factory=list)
    """(step, loss in levels on the validation presses); empty when all presses were fitted."""
    step: int = 0
    """Step that the weights are of."""


def fit_color_model(
    frames: Sequence[ColorFrame],
    background: np.ndarray,
    grid: PixelGrid,
    options: ColorFitOptions = ColorFitOptions(),
    *,
    mask: np.ndarray | None = None,
    progress: Progress = silent,
) -> ColorFit:
    """Fit the colour model to ``frames``.

    ``background`` is the untouched sensor, RGB levels, shape [height_px, width_px, 3]; pixels
    where ``mask`` is false are never used. Deterministic for a seed on one thread.
    """
    started = time.perf_counter()
    if not frames:
        raise InputError("the colour fit needs at least one press")
    drifts = {frame.name: frame_drift(frame, background, grid, mask, options) for frame in frames}
    rest_image = rest_background(frames, background, drifts, grid, mask, options)
    kept, watched = _split(frames, options.validation_every)
    trained = train(
        draw_samples(kept, rest_image, drifts, grid, mask, options),
        grid,
        options,
        validation=draw_samples(watched, rest_image, drifts, grid, mask, options)
        if watched
        else None,
        crops=_crops(kept, rest_image, drifts, grid, mask) if options.loss == "ssim" else (),
        progress=progress,
    )
    residuals = {
        frame.name: disc_l1(trained.model, frame, rest_image, drifts[frame.name], grid, mask)
        for frame in frames
    }
    return ColorFit(
        model=trained.model,
        background=rest_image,
        loss_curve=trained.curve,
        disc_l1_train=residuals,
        drifts=drifts,
        options=options,
        seconds=time.perf_counter() - started,
        inputs={frame.name: frame.sha256 for frame in frames if frame.sha256},
        validation_curve=trained.validation_curve,
        step=trained.step,
    )


def rest_background(
    frames: Sequence[ColorFrame],
    background: np.ndarray,
    drifts: Mapping[str, Light],
    grid: PixelGrid,
    mask: np.ndarray | None,
    options: ColorFitOptions,
) -> np.ndarray:
    """The background to render on: averaged with the untouched parts where the options say so."""
    if not options.average_background:
        return background.astype(np.float32)
    return average_background(
        background,
        [frame.image for frame in frames],
        [frame.circle for frame in frames],
        [drifts[frame.name] for frame in frames],
        grid,
        mask,
    )


def _split(
    frames: Sequence[ColorFrame], validation_every: int
) -> tuple[list[ColorFrame], list[ColorFrame]]:
    """Presses to fit and those that are watched; too few presses are all fitted."""
    if validation_every == 0 or len(frames) < 2 * validation_every:
        return list(frames), []
    watched = set(range(validation_every // 2, len(frames), validation_every))
    return (
        [frame for i, frame in enumerate(frames) if i not in watched],
        [frames[i] for i in sorted(watched)],
    )


def _crops(
    frames: Sequence[ColorFrame],
    rest_image: np.ndarray,
    drifts: Mapping[str, Light],
    grid: PixelGrid,
    mask: np.ndarray | None,
) -> list[Crop]:
    """The crop around each contact, in tiles of at most 64 px that hold no masked pixel."""
    crops = []
    index = np.arange(grid.width_px * grid.height_px).reshape(grid.height_px, grid.width_px)
    for frame in frames:
        rows, columns = crop_slices(frame.circle, grid)
        for v in range(rows.start, rows.stop - SSIM_WINDOW_PX, CROP_PX):
            for u in range(columns.start, columns.stop - SSIM_WINDOW_PX, CROP_PX):
                tile = (
                    slice(v, min(v + CROP_PX, rows.stop)),
                    slice(u, min(u + CROP_PX, columns.stop)),
                )
                if mask is not None and not mask[tile].all():
                    continue
                idx = index[tile]
                samples = samples_at(frame, idx.ravel(), rest_image, drifts[frame.name], grid)
                crops.append(Crop(samples, (idx.shape[0], idx.shape[1])))
    return crops


def disc_l1(
    model: ColorModel,
    frame: ColorFrame,
    rest_image: np.ndarray,
    drift: Light,
    grid: PixelGrid,
    mask: np.ndarray | None,
) -> float:
    """L1 of a press inside its contact circle, its drift applied to the render [levels]."""
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
