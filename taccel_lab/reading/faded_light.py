# SPDX-License-Identifier: Apache-2.0
"""Light that fades over a part of a grey image, told from a dent by the gel beside it.

A grey sensor shows a dent as a drop of brightness, and a lamp that has become weaker shows the
same. A tool may have any shape under its contact, but a bonded gel that hardly changes its volume
comes up beside it, by what the layer's law says (``bonded_layer``), and a grey sensor shows that,
too: the gel is brighter there. Both real units rise by 4.5 to 11 times the law's, a ball's press or
as little of it as is seen. Beside a fading lamp nothing rises. So what lies beside a smooth dark
spot is compared with the law, up to a quadratic over the image, which the light may be off by.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, pressure_under
from taccel_lab.reading.light import smoothed, unit_position
from taccel_lab.signals.depth_response import DepthMap, DepthResponse, channel_of

STEP_SHARE = 0.2
"""Steps of the small maps, in thicknesses of the gel,"""
LEAST_STEPS = 8
"""and the fewest of them."""
SMOOTH_SHARE = 0.35
"""Standard deviation of the Gaussian that smooth changes are found with, in thicknesses."""
ROUGH = 0.03
"""Part of a smooth change (sum of squares) that twice this Gaussian leaves: spots of light as wide
as half of the gel's thickness leave 0.02, a plate, a bar or a pin more."""
RISES, REAL_RISES = 0.25, 4.5
"""Rise over that of the law from which on there is a dent: tools drawn by it read 0.4 and more,
real ones at least the latter, from which a rise that is none has to be 2 standard deviations
away."""
LEAST_BESIDE = 0.5
"""Least part of the image that has to lie beside what is dark."""
LOOKS = 4
"""Looks for what stands out of the smooth change."""
BOWL = 0.8
"""Part of a change (sum of squares) that is quadratic over the image, from which on a tool as wide
as the view may have made it: a ball of 200 mm, 0.2 mm deep, has 0.82, one of 100 mm 0.46."""
MOST_FADED = 0.75, 1.33
"""Limits of the factor that light may have faded by: what is darker is looked at as it is."""
FEIGNED_SHARE = 0.3
"""Standard deviation of a depth, as a part of it, that light may feign: it may be 0."""
FADED = (
    "the light has faded over a part of the gel, beside which nothing rises as beside a dent: "
    "taken for no touch; look at the lamps, or give an image of the untouched gel as it is now "
    "(--background)"
)
MAYBE_FADED = (
    "the gel beside the contact is not seen to rise as beside a dent: the light may have faded "
    "there, so that the depth may be 0; look at the lamps, or give an image of the untouched gel "
    "as it is now (--background)"
)
"""Remarks on light that faded, or may have."""
PLANE = 3
"""Terms of a plane, of those of a quadratic."""
PENETRATION = 0.01
"""Tolerance of the law's pressure over the depth."""


@dataclass(frozen=True)
class FadedLight:
    """Light that may have faded where a touch is seen."""

    drop: np.ndarray
    """Drop by it [levels], shape [height_px, width_px]."""
    is_sure: bool
    """True where no dent looks so."""

    def factor(self, response: DepthResponse, untouched: np.ndarray) -> np.ndarray:
        """Factor of all channels of ``untouched``, RGB [h, w, 3], that it is, [h, w, 1]."""
        levels = np.maximum(channel_of(untouched, response.channel), 1.0)
        return np.clip(1.0 - self.drop / levels, *MOST_FADED)[..., None]


def faded_light(
    response: DepthResponse,
    found: DepthMap,
    drop: np.ndarray,
    touched: np.ndarray,
    grid: PixelGrid,
    layer: BondedLayer,
) -> FadedLight | None:
    """Look for it; None where a dent is seen.

    Args:
        response: From drops of grey to depths.
        found: Depths that were read.
        drop: Of grey [levels], shape [height_px, width_px].
        touched: Pixels that seem to be touched, bool, likewise.
        grid: Pixel grid of all.
        layer: The gel.
    """
    if found.reading_sigma_mm is None or found.depth_mm.max() >= layer.thickness_mm:
        return None
    step_mm = STEP_SHARE * layer.thickness_mm
    sides = (grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y)
    small = grid.resized(*(max(LEAST_STEPS, round(side / step_mm)) for side in sides))
    dark, inside = (
        cv2.resize(values, (small.width_px, small.height_px), interpolation=cv2.INTER_AREA)
        for values in (drop.astype(np.float32), touched.astype(np.float32))
    )
    inside = inside > 0.5
    blur = SMOOTH_SHARE * layer.thickness_mm / math.sqrt(small.mm_per_px_x * small.mm_per_px_y)
    smooth = _smooth(dark, None, blur)
    if np.square(dark - smooth).sum() > ROUGH * np.square(dark).sum() or not inside.any():
        return None
    sigma_mm = float(found.reading_sigma_mm.mean())
    depth_mm = response.signed_depth_of(dark)
    rises, off = _rise_beside(depth_mm, inside, small, layer, sigma_mm)
    if rises >= RISES:
        return None
    # A contact in the fading light stands out of what is smooth, the more the less it is in it.
    around = np.ones((2 * math.ceil(blur) + 1,) * 2, np.uint8)
    for _ in range(LOOKS):
        out = np.abs(response.signed_depth_of(dark - smooth)) > 2 * sigma_mm
        if not out.any():
            break
        smooth = _smooth(dark, cv2.dilate(out.astype(np.uint8), around) == 0, blur)
    return FadedLight(
        cv2.resize(smooth, drop.shape[::-1], interpolation=cv2.INTER_LINEAR),
        2 * off < REAL_RISES - rises and not _fills_view(dark),
    )


def _smooth(values: np.ndarray, counted: np.ndarray | None, blur: float) -> np.ndarray:
    """Smooth part of values [h, w], by those that count, without flattening its peak."""
    once = smoothed(values, counted, blur)
    return once + smoothed(values - once, counted, blur)


def _rise_beside(
    depth_mm: np.ndarray,
    inside: np.ndarray,
    grid: PixelGrid,
    layer: BondedLayer,
    sigma_mm: float,
) -> tuple[float, float]:
    """Rise of the gel beside a contact over that of the law, and its standard deviation; endless
    where too little lies beside."""
    steps = grid.mm_per_px_x, grid.mm_per_px_y
    rows, columns = (int(2 * layer.thickness_mm / step) + 1 for step in reversed(steps))
    wide = ((rows, rows), (columns, columns))
    gap = np.pad(np.where(inside, -depth_mm, FAR_MM), wide, mode="edge")
    sunk = pressure_under(gap, steps, layer, PENETRATION * -float(gap.min()))[1]
    rise = -sunk[rows:-rows, columns:-columns]
    beside = (rise > 0) & ~inside
    if beside.mean() < LEAST_BESIDE:
        return 0.0, math.inf
    by_law, seen = rise[beside].astype(np.float64), -depth_mm[beside]
    terms, rises, size = _quadratic(inside.shape)[:, beside], [], 0.0
    for count in (PLANE, len(terms)):
        alone = _without(by_law, terms[:count])
        size = float(np.square(alone).sum())
        rises.append(float(alone @ seen) / size)
    # Errors are as smooth as the gel is thick.
    area = max(beside.sum() * steps[0] * steps[1] / layer.thickness_mm**2, 1.0)
    return min(rises), sigma_mm / math.sqrt(size / len(seen) * area)


def _fills_view(dark: np.ndarray) -> bool:
    """Say whether drops, [h, w], are a bowl as wide as the view, beside which nothing is seen."""
    terms = _quadratic(dark.shape).reshape(6, -1)
    change = _without(dark.ravel().astype(np.float64), terms[:1])
    left = _without(change, terms)
    return float(np.square(left).sum()) < (1.0 - BOWL) * float(np.square(change).sum())


def _without(values: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Values [n] less what a sum of terms [m, n] explains of them."""
    basis = np.linalg.qr(terms.T)[0]
    return values - basis @ (basis.T @ values)


def _quadratic(shape: tuple[int, ...]) -> np.ndarray:
    """1, x, y, x^2, x y, y^2 over a map [h, w], shape [6, h, w]."""
    across, down = (each + np.zeros(shape) for each in unit_position(*shape))
    return np.stack([np.ones(shape), across, down, across**2, across * down, down**2])
