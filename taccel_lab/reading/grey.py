# SPDX-License-Identifier: Apache-2.0
"""Depths of a grey image that a gel can have: noise is averaged, dirt is named.

A grey sensor tells a depth pixel by pixel (``DepthResponse``), whatever made the pixel dark. The
face of a gel is no such map. Noise of a camera is no dent: where it is above what the calibration
knows, it is averaged over as many pixels as bring it there. And a gel goes along beside whatever is
pressed into it: a spot with a rim that is steeper than that of the sharpest punch is a speck.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.depth_response import DepthMap, DepthResponse

QUIET_SHARE = 0.6
"""Noise of pixels, as a part of the reading's standard deviation, that is left as it is."""
QUIET_LEVELS = 0.5
"""The same [levels] of curves that state none."""
LARGEST_SHARE = 0.1
"""Largest window that noise is averaged in, as a part of the gel's thickness."""
SEEN_MM, LEAST_MM = 0.05, 0.2
"""Depth that a spot is made out by, and that a speck has at its deepest: beside a press, steps of a
level or two have no rims."""
HALF, FOOT = 0.5, 0.1
"""Parts of a spot's depth that its width is taken at."""
SPECK_SHARE = 0.25
"""Radius of the largest specks, as a part of the thickness."""
RIM_SHARE, RIM_THICKNESS = 0.4, 0.125
"""A rim is as wide as this part of the spot's radius, or of an eighth of the thickness, between the
two. Beside a half plane, the sharpest tool, a layer comes up from half the depth to a tenth of it
over 0.07 of its thickness; beside a ball over twice the contact's radius."""
NAMED_PX = 12
"""Pixels of the smallest speck that is named: smaller ones are noise."""
BESIDE_PX = 2
"""Pixels beside a speck that it blurs into."""


@dataclass(frozen=True)
class GreyDepths:
    """Depths of a grey image."""

    depths: DepthMap
    drop: np.ndarray
    """Drops of grey that they are read from [levels], [h, w]."""
    remark: str = ""
    """Dirt that was taken off, a sentence."""


def grey_depths(
    response: DepthResponse,
    levels: np.ndarray,
    background: np.ndarray,
    grid: PixelGrid,
    thickness_mm: float,
    mask: np.ndarray | None = None,
) -> GreyDepths:
    """Read an image.

    Args:
        response: From drops of grey to depths.
        levels: RGB levels in the background's light, shape [height_px, width_px, 3].
        background: The untouched sensor, likewise.
        grid: Pixel grid of both.
        thickness_mm: Of the gel.
        mask: Pixels that count, bool, shape [h, w].
    """
    import cv2

    drop = response.drop(levels, background)
    if mask is not None:
        drop = np.where(mask, drop, response.drop_levels[0])
    pixel_mm = math.sqrt(grid.mm_per_px_x * grid.mm_per_px_y)
    window_px, noise = _window(response, drop, LARGEST_SHARE * thickness_mm / pixel_mm)
    if window_px > 0:
        drop = cv2.GaussianBlur(drop, (0, 0), window_px)
    found = response.of_drop(drop)
    specks = _specks(found.depth_mm, pixel_mm, thickness_mm)
    remark = ""
    if specks.any():
        remark = about_specks(specks, pixel_mm)
        wide = np.ones((2 * BESIDE_PX + 1,) * 2, np.uint8)
        specks = cv2.dilate(specks.astype(np.uint8), wide) > 0
        drop = np.where(specks, response.drop_levels[0], drop)
        found = response.of_drop(drop)
    if noise > 0 and found.sigma_mm is not None and found.reading_sigma_mm is not None:
        left_mm = noise * response.mm_per_level
        found = replace(
            found,
            sigma_mm=np.hypot(found.sigma_mm, left_mm),
            reading_sigma_mm=np.hypot(found.reading_sigma_mm, left_mm),
        )
    return GreyDepths(found, drop, remark)


def _window(response: DepthResponse, drop: np.ndarray, most_px: float) -> tuple[float, float]:
    """Standard deviation of the Gaussian that noise is averaged over [px], 0 where it need not be,
    and the noise that is left beyond what the curve knows [levels]."""
    quiet = QUIET_LEVELS
    if response.reading_sigma_mm is not None:
        quiet = QUIET_SHARE * response.reading_sigma_mm / max(response.mm_per_level, 1e-9)
    noise = pixel_noise(drop)
    if noise <= quiet:
        return 0.0, 0.0
    # White noise keeps 1 / (2 sqrt(pi) sigma) of its deviation.
    wanted_px = noise / (2 * math.sqrt(math.pi) * quiet)
    window_px = float(np.clip(wanted_px, 0.5, max(most_px, 0.5)))
    left = noise / max(2 * math.sqrt(math.pi) * window_px, 1.0)
    return window_px, math.sqrt(max(left**2 - quiet**2, 0.0))


def pixel_noise(values: np.ndarray) -> float:
    """Standard deviation of a map's noise, pixel by pixel, whatever is smooth in it (J. Immerkaer,
    Comput. Vis. Image Underst. 64(2), 1996), by its median."""
    import cv2

    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    sharp = np.abs(cv2.filter2D(values.astype(np.float32), -1, kernel))
    return float(np.median(sharp)) / (0.6745 * 6.0)


def _specks(depth_mm: np.ndarray, pixel_mm: float, thickness_mm: float) -> np.ndarray:
    """Pixels of spots that no gel of this thickness takes the shape of, bool, [h, w]."""
    import cv2

    found = np.zeros(depth_mm.shape, bool)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(
        (depth_mm > SEEN_MM).astype(np.uint8)
    )
    for part in range(1, count):
        left, top, width, height, _ = boxes[part]
        window = np.s_[top : top + height, left : left + width]
        inside = labels[window] == part
        depth = np.where(inside, depth_mm[window], 0.0)
        if depth.max() < LEAST_MM:
            continue
        half, foot = (
            math.sqrt(float((depth > share * depth.max()).sum()) / math.pi) * pixel_mm
            for share in (HALF, FOOT)
        )
        rim_mm = RIM_SHARE * min(half, RIM_THICKNESS * thickness_mm)
        if foot < SPECK_SHARE * thickness_mm and foot - half < rim_mm:
            found[window] |= inside
    return found


def about_specks(specks: np.ndarray, pixel_mm: float) -> str:
    """Number, size and place of the specks, a sentence; empty where they are a few pixels each."""
    import cv2

    _, _, boxes, middles = cv2.connectedComponentsWithStats(specks.astype(np.uint8))
    areas = boxes[1:, cv2.CC_STAT_AREA]
    many = int((areas >= NAMED_PX).sum())
    if not many:
        return ""
    largest = int(np.argmax(areas))
    wide_mm = 2 * math.sqrt(areas[largest] / math.pi) * pixel_mm
    x, y = middles[1 + largest]
    what = "a speck" if many == 1 else f"{many} specks, the largest"
    return (
        f"{what} {wide_mm:.2g} mm wide at ({x:.0f}, {y:.0f}) px, darker than a gel can be pressed "
        "there without going along beside it: taken for dirt on gel or lens, and for no touch"
    )
