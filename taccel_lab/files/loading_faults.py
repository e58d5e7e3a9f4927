# SPDX-License-Identifier: Apache-2.0
"""Faults of recorded loadings that their numbers alone tell: what no press of a gel can be.

The force of a tool that is pressed into a gel is 0 at the touch and rises with the depth, of a ball
with its power 1.5 at least (Hertz; a bonded layer stiffens it further), of a flat end with its
power 1. Whatever a load cell or a stage is off by moves such a curve without bending it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from taccel_lab.errors import InputError

SURE = 4.0
"""Standard deviations from which a fault is no noise."""
BENT = 0.05
"""Least height of a curve over its chord that is spoken of, as a part of the forces' range: a press
by Hertz' law hangs 0.15 below it, and with the columns swapped it stands 0.13 above."""
RELAXED = 0.5
"""Largest change of a force at one depth, as a part of the largest force: gels relax by less."""
VARIED = 0.2
"""Ranges of depth, as a part of the largest, from which the force has to rise."""
TOUCH_MM = 0.5
"""How far from the true one a touch may be stated."""
OFFSET = 0.02
"""Least force at such a touch that is spoken of, as a part of the largest."""


def without_repeats(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns by name with rows that say the same as the row before counted once; shape [row]."""
    rows = np.stack(list(columns.values()), axis=1)
    same = (rows[1:] == rows[:-1]) | (np.isnan(rows[1:]) & np.isnan(rows[:-1]))
    new = np.append(True, ~same.all(axis=1))
    return {name: values[new] for name, values in columns.items()}


def require_loading(
    depth_mm: np.ndarray, force_n: np.ndarray, sigma_n: float, *, ball: bool
) -> None:
    """Refuse a loading whose force is constant, whose columns are swapped, or whose zero is off.

    Args:
        depth_mm: Past first touch, rising, shape [row].
        force_n: Into the gel, shape [row].
        sigma_n: Standard deviation of a force [N], where too few rows show it.
        ball: Whether the tool is one.

    Raises:
        InputError: What was found, and what is allowed; without the file's name.
    """
    _require_one_force_a_depth(depth_mm, force_n, sigma_n)
    if len(np.unique(depth_mm)) < 3 or np.ptp(depth_mm) < VARIED * depth_mm.max():
        return
    middle, half = 0.5 * (depth_mm.min() + depth_mm.max()), 0.5 * float(np.ptp(depth_mm))
    (_, slope, bend), (_, slope_sigma, bend_sigma) = _parabola(
        (depth_mm - middle) / half, force_n, sigma_n
    )
    if slope <= SURE * slope_sigma:
        raise InputError(
            f"force_n does not rise with depth_mm: it is {force_n[0]:g} N at {depth_mm[0]:g} mm "
            f"and {force_n[-1]:g} N at {depth_mm[-1]:g} mm. Is it the right column, and was the "
            "load cell read?"
        )
    if ball and -bend > max(SURE * bend_sigma, BENT * float(np.ptp(force_n))):
        raise InputError(
            "force_n rises ever less with depth_mm, and that of a ball rises ever more. Are the "
            "columns swapped, or does the load cell end there?"
        )
    _require_zero(depth_mm, force_n, sigma_n, 1.5 if ball else 1.0)


def _require_one_force_a_depth(depth_mm: np.ndarray, force_n: np.ndarray, sigma_n: float) -> None:
    """Refuse rows of one depth whose forces differ beyond noise, and beyond what a gel relaxes."""
    starts = np.append(0, np.flatnonzero(np.diff(depth_mm)) + 1)
    low, high = (ends.reduceat(force_n, starts) for ends in (np.minimum, np.maximum))
    worst = int(np.argmax(high - low))
    if high[worst] - low[worst] > max(2 * SURE * sigma_n, RELAXED * float(force_n.max())):
        raise InputError(
            f"force_n goes from {low[worst]:g} to {high[worst]:g} N while depth_mm stays at "
            f"{depth_mm[starts[worst]]:g}: is it the right column, and was the stage read?"
        )


def _require_zero(depth_mm: np.ndarray, force_n: np.ndarray, sigma_n: float, power: float) -> None:
    """Refuse forces that even a touch well before the stated one does not explain.

    With F = c (d - t)^n the touch is t = d - n F / F'; a larger n than ``power`` moves it deeper.
    """
    shallow = depth_mm <= 0.5 * (depth_mm.min() + depth_mm.max())
    if len(np.unique(depth_mm[shallow])) < 3:
        shallow = depth_mm <= np.unique(depth_mm)[1]
    x, y = depth_mm[shallow] - depth_mm[0], force_n[shallow]
    reach = (depth_mm[0] + TOUCH_MM) / power
    scale = float(x.max())
    (start, slope, _), _ = _parabola(x / scale, y, sigma_n)
    at_touch, sigma = _combined(x / scale, y, sigma_n, np.array([1.0, -reach / scale, 0.0]))
    # A parabola over the bend at a late touch falls at first.
    if min(at_touch, start) > max(SURE * sigma, OFFSET * float(force_n.max())):
        raise InputError(
            f"force_n is {start:.3g} N at {depth_mm[0]:g} mm and rises by {slope / scale:.3g} N/mm "
            "there: it would be 0 long before the touch, so the load cell's zero is off. Record "
            "some rows in air before the touch (depth_mm below 0), or take the offset off"
        )


def _design(x: np.ndarray) -> np.ndarray:
    """Columns 1, x and x^2; without the last where fewer than three places leave it open."""
    return np.stack([np.ones_like(x), x, x**2], axis=1)[:, : min(3, len(np.unique(x)))]


def _parabola(
    x: np.ndarray, y: np.ndarray, sigma: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Coefficients of a parabola through points, the constant first, and their deviations."""
    found = [_combined(x, y, sigma, row) for row in np.eye(3)]
    values, sigmas = zip(*found, strict=True)
    return values, sigmas


def _combined(
    x: np.ndarray, y: np.ndarray, sigma: float, weights: np.ndarray
) -> tuple[float, float]:
    """A weighted sum of the coefficients, shape [3], and its standard deviation."""
    columns = _design(x)
    weights = weights[: columns.shape[1]]
    found, *_ = np.linalg.lstsq(columns, y, rcond=None)
    free = len(y) - columns.shape[1]
    if free >= 5:
        sigma = float(np.sqrt(np.sum((columns @ found - y) ** 2) / free))
    spread = weights @ np.linalg.pinv(columns.T @ columns) @ weights
    return float(weights @ found), sigma * float(np.sqrt(spread))
