# SPDX-License-Identifier: Apache-2.0
"""Pictures of dots with known centres, drawn wider than the picture so that its border is real."""

from __future__ import annotations

import numpy as np

from tests.calibration.drawn.discs import draw_dots
from tests.calibration.drawn.faults import add_noise, blur, quantise

WIDTH, HEIGHT = 320, 240
MARGIN = 40


def grid_points(
    rows: int = 7,
    columns: int = 9,
    pitch: tuple[float, float] = (30.0, 29.0),
    *,
    turn_rad: float = 0.0,
    centre: tuple[float, float] = (159.3, 119.8),
    stagger: float = 0.0,
) -> np.ndarray:
    """Centres row by row, shape [rows * columns, 2]."""
    row, column = np.mgrid[:rows, :columns].reshape(2, -1)
    x = (column + stagger * (row % 2) - (columns - 1) / 2) * pitch[0]
    y = (row - (rows - 1) / 2) * pitch[1]
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return np.stack([c * x - s * y, s * x + c * y], axis=1) + centre


def picture(
    centres: np.ndarray,
    radius: float | np.ndarray = 5.0,
    *,
    noise: float = 0.0,
    blur_px: float = 0.8,
    seed: int = 0,
    levels: bool = True,
    background: float | np.ndarray = 160.0,
    dot: float | np.ndarray = 25.0,
) -> np.ndarray:
    """A grey picture of 320 x 240 px; ``levels`` rounds it to whole ones."""
    wide = draw_dots(
        WIDTH + 2 * MARGIN,
        HEIGHT + 2 * MARGIN,
        np.asarray(centres) + MARGIN,
        radius,
        background=background,
        dot=dot,
    )
    if blur_px > 0:
        wide = blur(wide, blur_px)
    image = wide[MARGIN:-MARGIN, MARGIN:-MARGIN]
    if noise > 0:
        image = add_noise(image, noise, np.random.default_rng(seed))
    return quantise(image) if levels else image


def nearest(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the nearest true point of each found one, and the way to it."""
    index = np.argmin(np.linalg.norm(found[:, None] - true[None], axis=2), axis=1)
    return index, found - true[index]
