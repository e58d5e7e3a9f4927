# SPDX-License-Identifier: Apache-2.0
"""How far heights and image of a press may be off: by its resolution, and by all that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from taccel_lab.presses.press_outcome import PressOutcome
    from taccel_lab.profile import Provenance

_AROUND = 0.05
"""Part of the depth from which on a pixel counts as pressed."""
_WHITE = 255.0


@dataclass(frozen=True)
class SignalError:
    """Root mean square error over the pressed pixels, in the signal's unit."""

    numerical: float
    """By mesh, contact range and steps."""
    total: float
    """With a depth and place that were read, and with the colours' own error."""


def height_error_mm(outcome: PressOutcome, depth_sigma_mm: float) -> SignalError:
    """Error of the heights [mm]; ``depth_sigma_mm``: deviation of a depth that was read."""
    numerical = 1e3 * outcome.height_error_m
    moved = 1e3 * (outcome.rest_height_m - outcome.height_m)[_pressed(outcome)]
    depth = known_rms(moved) * 2 * depth_sigma_mm / outcome.path.depth_mm
    return SignalError(numerical, math.hypot(numerical, depth))


def image_error_levels(
    outcome: PressOutcome,
    rgb: np.ndarray,
    beside_rgb: np.ndarray,
    background_rgb: np.ndarray,
    colours: Provenance,
    depth_sigma_mm: float,
    place_sigma_px: float,
) -> SignalError:
    """Error of an image in a profile's colours [levels of 255].

    Args:
        outcome: The press.
        rgb: Its image, levels, [height_px, width_px, 3].
        beside_rgb: That of the coarser press beside it.
        background_rgb: The untouched sensor.
        colours: Of the colour model: the held-out peak signal-to-noise ratio is its error.
        depth_sigma_mm: Standard deviation of a depth that was read [mm].
        place_sigma_px: The same of a place, along each axis [px].
    """
    where = _pressed(outcome)
    numerical = known_rms((rgb - beside_rgb)[where])
    changed = rgb - background_rgb
    depth = known_rms(changed[where]) * 2 * depth_sigma_mm / outcome.path.depth_mm
    slopes = [known_rms(np.gradient(changed, axis=axis)[where]) for axis in (0, 1)]
    place = math.hypot(*slopes) * 2 * place_sigma_px
    psnr_db = colours.residuals.get("heldout_crop_psnr_db")
    seen = 0.0 if psnr_db is None else _WHITE * 10 ** (-psnr_db / 20)
    return SignalError(numerical, math.hypot(numerical, depth, place, seen))


def _pressed(outcome: PressOutcome) -> np.ndarray:
    """Pixels that the press moved, bool, [height_px, width_px]."""
    moved = outcome.rest_height_m - outcome.height_m
    return np.nan_to_num(np.abs(moved)) > _AROUND * 1e-3 * outcome.path.depth_mm


def known_rms(values: np.ndarray) -> float:
    """Root of the mean square of what is finite; 0 of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
