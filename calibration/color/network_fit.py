# SPDX-License-Identifier: Apache-2.0
"""Fit the colour model to captures: surface of each press in, weights with their residuals out."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import (
    ColorFrame,
    ColorSamples,
    draw_samples,
)
from taccel_lab.calibration.color.training import train
from taccel_lab.calibration.color.untouched_light import light_beside
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.color_model import ColorModel


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
    drifts = {
        frame.name: light_beside(frame.image, background, frame.circle, grid, mask)
        for frame in frames
    }
    samples = draw_samples(frames, background, drifts, grid, mask, options)
    trained = train(samples, grid, options, progress=progress)
    model = ColorModel(trained.model.config, trained.model.weights, steepest_deg(samples))
    residuals = {
        frame.name: disc_l1(model, frame, background, drifts[frame.name], grid, mask)
        for frame in frames
    }
    return ColorFit(
        model=model,
        background=background.astype(np.float32),
        loss_curve=trained.curve,
        disc_l1_train=residuals,
        drifts=drifts,
        options=options,
        seconds=time.perf_counter() - started,
        inputs={frame.name: frame.sha256 for frame in frames if frame.sha256},
    )


def steepest_deg(samples: ColorSamples) -> float:
    """Tilt of the steepest normals that a fit is shown: one in 10,000 leans further."""
    return math.degrees(math.acos(np.clip(np.quantile(samples.normals[:, 2], 1e-4), 0.0, 1.0)))


def disc_l1(
    model: ColorModel,
    frame: ColorFrame,
    rest_image: np.ndarray,
    drift: LightDrift,
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
    light = drift.at(np.flatnonzero(disc), grid.height_px, grid.width_px)
    rendered = light.apply(np.clip(rest_image[disc] + change, 0.0, 255.0))
    return float(np.abs(rendered - frame.image[disc]).mean())
