# SPDX-License-Identifier: Apache-2.0
"""What the colour fit is given: presses with images and surfaces, and pixels drawn of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import UNTOUCHED_RADII, ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.calibration.pixel_draw import draw_regions
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig, pixel_uv


@dataclass(frozen=True)
class ColorFrame:
    """One training press: what the camera saw and the surface the simulation gave."""

    name: str
    image: np.ndarray
    """RGB levels, shape [height_px, width_px, 3]."""
    circle: ContactCircle
    surface: BallSurface
    sha256: str = ""


@dataclass(frozen=True)
class ColorSamples:
    """Pixels drawn from presses."""

    uv: np.ndarray
    normals: np.ndarray
    rest_normals: np.ndarray
    displacement_mm: np.ndarray
    change: np.ndarray
    """Captured minus background [levels], shape [n, 3]."""


def draw_samples(
    frames: Sequence[ColorFrame],
    rest_image: np.ndarray,
    drifts: Mapping[str, LightDrift],
    grid: PixelGrid,
    mask: np.ndarray | None,
    options: ColorFitOptions,
) -> ColorSamples:
    """Pixels of the frames: the contact disc, the ring around it and the untouched rest."""
    rng = np.random.default_rng(options.seed)
    parts = []
    for frame in frames:
        idx = draw_pixels(frame, grid, mask, options, rng)
        parts.append(samples_at(frame, idx, rest_image, drifts[frame.name], grid))
    return join_samples(parts)


def join_samples(parts: Sequence[ColorSamples]) -> ColorSamples:
    """One after the other."""
    return ColorSamples(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ColorSamples.__dataclass_fields__
        )
    )


def samples_at(
    frame: ColorFrame,
    pixel_idx: np.ndarray,
    rest_image: np.ndarray,
    drift: LightDrift,
    grid: PixelGrid,
) -> ColorSamples:
    """Given pixels of a frame; ``pixel_idx`` counts along rows."""
    surface = frame.surface
    there = drift.at(pixel_idx, grid.height_px, grid.width_px)
    image = there.remove(frame.image.reshape(-1, 3)[pixel_idx].astype(np.float64))
    return ColorSamples(
        pixel_uv(ColorModelConfig(grid.width_px, grid.height_px), pixel_idx),
        surface.normals.reshape(-1, 3)[pixel_idx],
        surface.rest_normals.reshape(-1, 3)[pixel_idx],
        surface.displacement_mm().reshape(-1)[pixel_idx],
        image - rest_image.reshape(-1, 3)[pixel_idx],
    )


def draw_pixels(
    frame: ColorFrame,
    grid: PixelGrid,
    mask: np.ndarray | None,
    options: ColorFitOptions,
    rng: np.random.Generator,
) -> np.ndarray:
    """Indices of the pixels that the options ask for, counted along rows."""
    distance = frame.circle.distance_px(grid) / frame.circle.radius_px
    usable = np.ones_like(distance, dtype=bool) if mask is None else mask
    regions = [
        (usable & (distance >= low) & (distance < high), count)
        for low, high, count in (
            (0.0, 1.3, options.disc_pixels),
            (1.3, UNTOUCHED_RADII, options.ring_pixels),
            (UNTOUCHED_RADII, np.inf, options.far_pixels),
        )
    ]
    return np.concatenate(draw_regions(frame.name, regions, rng))
