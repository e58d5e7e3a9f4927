# SPDX-License-Identifier: Apache-2.0
"""A monotone curve from grey drop to depth, fitted to the pixels inside ball contacts.

The curve is the isotonic regression of depth on drop (R. E. Barlow et al., Statistical Inference
under Order Restrictions, 1972; scipy's pool-adjacent-violators), read at evenly spaced drops and
joined by a monotone cubic (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980; scipy's PCHIP).
Below the smallest drop that a contact shows it runs straight to zero depth at zero drop, so that
untouched gel reads as untouched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.heights import BAND_SIGMAS
from taccel_lab.robust_fit import radius_factor
from taccel_lab.signals.depth_response import Channel, DepthResponse

INNER_RADII = 0.95
"""Pixels within this many contact radii are used."""
KNOT_LEVELS = 4.0
"""Distance of the curve's knots [levels]."""
TABLE_LEVELS = 1.0
"""Distance of the stored table's entries [levels]."""
SHARE = 0.95
MIN_PIXELS = 200
MIN_NEAR = 6
"""Pixels that a knot needs within a step."""
SECTOR_COUNT = 8
START_SHARE = 0.4
"""Share of the range of drops that the line to zero drop is fitted over."""
LOWEST_SHARE = 0.005
"""Share of the pixels that may lie beyond either end of the curve."""


@dataclass(frozen=True)
class ContactPixels:
    """Pixels of one press whose depth is known."""

    press: int
    drop_levels: np.ndarray
    """Shape [n]."""
    depth_mm: np.ndarray
    """Depth below the resting face, shape [n]."""
    sector: np.ndarray
    """Eighth of the circle that a pixel lies in, shape [n]."""
    u_px: np.ndarray
    v_px: np.ndarray
    background: np.ndarray
    """Level of the untouched pixel, shape [n]."""

    def of(self, keep: np.ndarray) -> ContactPixels:
        """Some of these pixels, bool, shape [n]."""
        arrays = {name: value[keep] for name, value in vars(self).items() if name != "press"}
        return replace(self, **arrays)


def contact_pixels(
    press: int,
    drop: np.ndarray,
    background: np.ndarray,
    circle: ContactCircle,
    grid: PixelGrid,
    ball_radius_mm: float,
    rim_depth_mm: float,
    mask: np.ndarray | None = None,
) -> ContactPixels:
    """Pixels inside a contact with their depth: the ball's below the rim, and the rim's own.

    ``drop`` and ``background`` are one channel [levels], shape [height_px, width_px].
    """
    distance = circle.distance_px(grid)
    inside = distance <= INNER_RADII * circle.radius_px
    if mask is not None:
        inside &= mask
    if inside.sum() < MIN_PIXELS:
        raise InputError(
            f"a contact of radius {circle.radius_px:.0f} px leaves {int(inside.sum())} usable "
            f"pixels; at least {MIN_PIXELS} are needed"
        )
    rows, columns = np.nonzero(inside)
    r_mm = distance[inside] * grid.mm_per_px_x
    rim_mm = circle.radius_px * grid.mm_per_px_x
    below = np.sqrt(ball_radius_mm**2 - r_mm**2) - np.sqrt(ball_radius_mm**2 - rim_mm**2)
    angle = np.arctan2(rows - circle.v_px, columns - circle.u_px)
    sector = ((angle / (2 * np.pi) + 0.5) * SECTOR_COUNT).astype(int) % SECTOR_COUNT
    return ContactPixels(
        press, drop[inside], below + rim_depth_mm, sector, columns, rows, background[inside]
    )


def fit_response(parts: Sequence[ContactPixels], channel: Channel = "grey") -> DepthResponse:
    """The curve through all pixels; presses weigh alike."""
    drop = np.concatenate([p.drop_levels for p in parts])
    depth = np.concatenate([p.depth_mm for p in parts])
    weight = np.concatenate([np.full(len(p.drop_levels), 1.0 / len(p.drop_levels)) for p in parts])
    order = np.argsort(drop, kind="stable")
    drop, depth, weight = drop[order], depth[order], weight[order]
    low, high = np.quantile(drop, [LOWEST_SHARE, 1 - LOWEST_SHARE])
    low = max(float(low), TABLE_LEVELS)
    if high < low + KNOT_LEVELS:
        raise InputError(
            f"the contacts darken by {high:.1f} levels at most, from {low:.1f} on; a curve needs "
            f"at least {KNOT_LEVELS:g} levels between. Press deeper, or give more light"
        )
    fitted = isotonic_regression(depth, weights=weight).x
    count = max(3, round((high - low) / KNOT_LEVELS) + 1)
    knots = np.linspace(low, high, count)
    values = np.array([_at_knot(knot, knots[1] - knots[0], drop, fitted, weight) for knot in knots])
    known = np.isfinite(values)
    values = np.interp(knots, knots[known], values[known])
    values = np.maximum.accumulate(np.maximum(values, 0.0))
    table = np.arange(low, high, TABLE_LEVELS)
    table = np.append(table, high) if high - table[-1] > 0.25 * TABLE_LEVELS else table
    curve = np.maximum.accumulate(PchipInterpolator(knots, values)(table))
    return DepthResponse(channel, np.append(0.0, table), np.append(0.0, curve))


def _at_knot(
    knot: float, step: float, drop: np.ndarray, fitted: np.ndarray, weight: np.ndarray
) -> float:
    """Value of a parabola through the fit within one step of a knot; NaN where next to none is."""
    near = np.abs(drop - knot) <= step
    if near.sum() < MIN_NEAR:
        return float("nan")
    degree = 2 if np.ptp(drop[near]) > step else 1 if np.ptp(drop[near]) > 0.2 * step else 0
    local = np.polyfit(drop[near] - knot, fitted[near], degree, w=np.sqrt(weight[near]))
    return float(local[-1])


def depth_at_no_drop(part: ContactPixels) -> float:
    """Depth [mm] at which a press's own curve meets zero drop, by a line through its low end."""
    low = max(float(np.quantile(part.drop_levels, 0.02)), 0.0)
    high = low + START_SHARE * (float(part.drop_levels.max()) - low)
    near = (part.drop_levels >= low) & (part.drop_levels <= high)
    slope, level = np.polyfit(part.drop_levels[near], part.depth_mm[near], 1)
    return float(level) if slope > 0 else float(part.depth_mm[near].min())


def left_out_errors(parts: Sequence[ContactPixels]) -> tuple[list[np.ndarray], str]:
    """Absolute errors [mm] of pixels that a fit did not see, by what was left out, and what that
    was.

    Whole presses where there are several, else eighths of the one contact.
    """
    errors = []
    if len(parts) > 1:
        for i, part in enumerate(parts):
            fit = fit_response([p for k, p in enumerate(parts) if k != i])
            errors.append(np.abs(fit.depth_of(part.drop_levels) - part.depth_mm))
        return errors, "press"
    for sector in range(SECTOR_COUNT):
        out = parts[0].sector == sector
        if not out.any() or out.all():
            continue
        fit = fit_response([parts[0].of(~out)])
        errors.append(np.abs(fit.depth_of(parts[0].drop_levels[out]) - parts[0].depth_mm[out]))
    return errors, "eighth of the contact"


def reading_sigma_mm(left_out_mm: Sequence[np.ndarray]) -> float:
    """Standard deviation [mm], two of which hold 95 % of the pixels of a new press in the mean
    (cross-conformal); those of the worst one where there are too few to tell how they differ."""
    worst = max(float(np.quantile(errors, SHARE)) for errors in left_out_mm)
    return radius_factor(left_out_mm, SHARE, worst) / BAND_SIGMAS


def curve_spread_mm(
    parts: Sequence[ContactPixels], response: DepthResponse, rng: np.random.Generator, count: int
) -> np.ndarray:
    """Standard deviation of the curve [mm] at its own drops, by resampling eighths of contacts."""
    blocks = [
        part.of(part.sector == sector)
        for part in parts
        for sector in range(SECTOR_COUNT)
        if (part.sector == sector).sum() > 10
    ]
    curves = []
    for _ in range(count):
        picked = rng.integers(0, len(blocks), len(blocks))
        curves.append(fit_response([blocks[k] for k in picked]).depth_of(response.drop_levels))
    return np.std(curves, axis=0)
