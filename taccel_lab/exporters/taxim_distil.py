# SPDX-License-Identifier: Apache-2.0
"""Taxim's table made from a profile's colour model, by least squares in every bin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.exporters.press_samples import ColorSource
from taccel_lab.exporters.taxim_table import (
    TERMS,
    Direction,
    TaximTable,
    bin_steps,
    one_scale,
    pixel_terms,
)
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.normals import normals_from_slopes

COLUMNS, ROWS = 8, 6
"""Pixels over the image at which each bin is asked."""
ENCODED_COLUMNS, ENCODED_ROWS = 16, 12
"""The same with a positional encoding, each anywhere in its cell: pixels in step with a band would
show it as a constant."""
SEED = 0
CHECKED = 20_000


@dataclass(frozen=True)
class DistilledTable:
    """A table, with how far it is from the model that it was made from."""

    table: TaximTable
    mm_per_px: float
    """The one scale that the reader takes for both axes."""
    errors: dict[str, float]


def distil_table(
    profile: SensorProfile, bins: int, direction: Direction = "normal"
) -> DistilledTable:
    """The table that answers like the profile's colour model in ball presses.

    Slopes are those over the gel's rest surface, so that untouched gel, which the first bin of tilt
    stands for, keeps the background exactly. A reader measures slopes in pixels of one scale; where
    the profile has two, the bins are filled with what it will look up there. Beyond the steepest
    surface that the colour block was fitted to, the last bin is repeated.
    """
    source = ColorSource(profile)
    rng = np.random.default_rng(SEED)
    scale, stretch = one_scale(profile.grid())
    pixels, solve = _image_fit(source, rng)
    tilts, displacements = source.profiles(rng, 400_000)
    order = np.argsort(tilts)
    tilts, displacements = tilts[order], displacements[order]
    step_tilt, step_angle = bin_steps(bins)
    angle = (np.arange(bins) + 0.5) * step_angle - np.pi
    if direction == "normal":
        angle = angle + np.pi  # the gradient points away from where the normal leans
    toward = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    last = max(1, int(source.max_tilt_rad / step_tilt))
    grad = np.zeros((3, bins, bins, TERMS))
    for tilt_bin in range(1, min(last + 1, bins)):
        first, end = np.searchsorted(tilts, [tilt_bin * step_tilt, (tilt_bin + 1) * step_tilt])
        first, end = _at_least(first, end, 200, len(tilts))
        drawn = rng.integers(first, end, (bins, len(pixels)))
        middle = min((tilt_bin + 0.5) * step_tilt, source.max_tilt_rad)
        slope = np.broadcast_to(
            np.tan(middle) * (toward * stretch)[:, None, :], (bins, len(pixels), 2)
        )
        change = source.change(
            np.tile(pixels, bins), slope.reshape(-1, 2), displacements[drawn].ravel()
        )
        fitted = np.einsum("kp,bpc->cbk", solve, change.reshape(bins, len(pixels), 3))
        grad[:, tilt_bin] = fitted
    grad[:, min(last + 1, bins) :] = grad[:, [min(last, bins - 1)]]
    table = TaximTable(bins, grad, direction)
    return DistilledTable(table, scale, _errors(table, source, stretch, rng))


def _image_fit(source: ColorSource, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Flat indices of pixels spread over the image, and the matrix that fits the six terms to
    values there, [6, pixel]."""
    config = source.model.config
    columns, rows, within = COLUMNS, ROWS, np.float64(0.5)
    if config.position_bands:
        columns, rows = ENCODED_COLUMNS, ENCODED_ROWS
        within = rng.uniform(0, 1, (2, rows, columns))
    cell = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="xy")) + within
    size = np.array([config.width_px, config.height_px])[:, None, None]
    count = np.array([columns, rows])[:, None, None]
    place = np.rint(cell / count * size - 0.5).astype(np.int64)
    uu, vv = np.clip(place, 0, size - 1).reshape(2, -1)
    on_gel = source.rest.covered[vv, uu]
    if on_gel.sum() >= 2 * TERMS:
        uu, vv = uu[on_gel], vv[on_gel]
    # In units of the image, or the squares would swamp the constant.
    units = np.array([config.width_px, config.height_px], dtype=np.float64)
    solve = np.linalg.pinv(pixel_terms(uu / units[0], vv / units[1]))
    back = pixel_terms(*(1 / units))
    return vv * config.width_px + uu, solve * back[:, None]


def _at_least(first: int, end: int, count: int, length: int) -> tuple[int, int]:
    """The range, widened to ``count`` samples where it holds fewer."""
    lacking = max(0, count - (end - first))
    first = max(0, min(first - lacking // 2, length - count))
    return first, min(length, max(end, first + count))


def _errors(
    table: TaximTable, source: ColorSource, stretch: np.ndarray, rng: np.random.Generator
) -> dict[str, float]:
    """The table against the model on presses that were not asked before."""
    drawn = source.draw(rng, CHECKED)
    width = source.model.config.width_px
    normals = normals_from_slopes(drawn.slope / stretch)
    truth = source.change(drawn.pixel_idx, drawn.slope, drawn.displacement_mm)
    off = table.change_at(normals, drawn.pixel_idx % width, drawn.pixel_idx // width) - truth
    return {
        "table_rms_levels": float(np.sqrt((off**2).mean())),
        "table_p95_levels": float(np.quantile(np.abs(off), 0.95)),
        "model_rms_levels": float(np.sqrt((truth**2).mean())),
        "steepest_tilt_deg": float(np.rad2deg(source.max_tilt_rad)),
    }
