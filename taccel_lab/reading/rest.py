# SPDX-License-Identifier: Apache-2.0
"""The part of an image that heights are counted from, where a flat tool leaves it open.

Heights of slopes have no zero of their own. Beside a small contact the image's border is at rest.
Under a half plane or a wide plate a part of the border, or all of it, is pressed as flat as the gel
beside it lies. Two things tell them apart. A tool's rim is a narrow band that flat parts lie on
both sides of, and a gel that is pushed and never pulled lies highest where nothing touches. So the
flat parts are found, each between bands, and those count that are highest.

A gel does not lie at rest right beside a wide tool: it sinks next to the rim and bulges beyond, by
up to half of the depth. By how much where heights are counted from, the layer's law tells
(``bonded_layer``) of the parts that are pressed, which are taken to go on beyond the image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, press_layer
from taccel_lab.reading.slope_integration import height_from_slopes

QUIET_SHARE, NOISE_TIMES = 0.3, 4.0
"""Blocks are flat below this multiple of the tilt that this part of them stays below,"""
LEAST_FLAT_DEG, MOST_FLAT_DEG = 0.8, 3.0
"""but at least and at most below these."""
PART_SHARE = 0.02
"""Least part of the image that a flat part fills."""
STEEP_SHARE, BAND_TIMES = 0.8, 2.0
"""A band's tilt, this part of its blocks left below, over the largest of flat ones."""
BAND_BLOCKS = 9
"""Twice its width at most, in blocks."""
LEAST_MM = 0.015
"""Least difference of two parts."""
PRESSED_SHARE = 0.5
"""Part of the image's whole depth from which on a part lies lower than another: what errors add up
to on the way over a contact is a fifth of what is climbed."""
FLAT_SHARE = 0.5
"""Least part of the image that rests or is pressed flat: beside a finger levels mean little."""
BORDER_SEEN = 0.9
"""Least part of the border that counts: a mask may cut a contact into what looks like a plate."""
RING_FLAT = 0.25
"""Part of the outermost blocks that are flat, below which none of them is at rest for certain."""
INNER_SHARE = 0.3
"""Part of the image that one flat part fills, where the border is its rim."""
RIM_SHARE = 0.25
"""Part of the way up from what is pressed within which the tool still touches."""
BEYOND = 2.0
"""Thicknesses by which what is pressed goes on beyond the image."""
BULGE_SHARE, HIDDEN_SHARE = 0.25, 0.5
"""Standard deviations of a bulge, as a part of it, by which bulges beside 13 tools with sharp rims
and with rims of 1 mm are off; and of a border that hides its zero, as a part of the depth."""
BULGES = -0.8, 0.6
"""Limits of a bulge over the depth: right beside a rim the law's pressure is endless."""


@dataclass(frozen=True)
class RestingPart:
    """What a coarse look at an image says of its zero."""

    blocks: np.ndarray
    """Blocks that heights may be counted from, bool, shape [h, w]."""
    pressed: np.ndarray
    """Flat blocks that surely lie lower, bool, shape [h, w]."""
    rims: np.ndarray
    """Blocks between the two, likewise."""
    bulge_m: float
    """Rise of the former over the face at rest by the layer's law [m]; negative where they sink."""
    sigma_m: float
    """Its standard deviation [m]."""
    hidden: bool
    """Whether none of it is at rest for certain: a rim goes along the whole border."""

    @property
    def remark(self) -> str:
        """A sentence for the user; empty where heights are counted from what is at rest."""
        if not self.hidden:
            return ""
        return (
            "nothing in view is at rest for certain: the contact reaches the border all around, "
            "where the gel is taken to lie as beside a plate; depth and force are lower bounds"
        )


def resting_part(
    tilt_deg: np.ndarray,
    slope: np.ndarray,
    grid: PixelGrid,
    layer: BondedLayer | None,
    mask: np.ndarray | None = None,
) -> RestingPart | None:
    """Find it; None where the flat border as a whole is the zero.

    Args:
        tilt_deg: Of blocks from rest [degrees], shape [h, w].
        slope: dh/dx and dh/dy of blocks over those at rest, shape [h, w, 2].
        grid: Of the blocks.
        layer: The gel; None where it is no flat layer.
        mask: Blocks that count, bool, shape [h, w]; all when None.
    """
    counted = np.ones(tilt_deg.shape, bool) if mask is None else mask
    flat, flat_deg = flat_blocks(tilt_deg, counted)
    labels, sizes = _parts(flat)
    large = [k for k in range(1, len(sizes)) if sizes[k] >= PART_SHARE * flat.size]
    whole = _ring(flat.shape)
    ring = whole & counted
    if ring.sum() < BORDER_SEEN * whole.sum():
        return None
    hidden = bool(
        flat[ring].sum() < RING_FLAT * ring.sum()
        and max(sizes[1:], default=0) > INNER_SHARE * flat.size
    )
    if not large or (len(large) == 1 and not hidden):
        return None
    # The slope that flat blocks share is an error of all; a step between them is not in it.
    weights = None if mask is None else counted.astype(float)
    height_mm = 1e3 * height_from_slopes(slope - slope[flat].mean(axis=0), grid, weights=weights)
    levels = {part: float(height_mm[labels == part].mean()) for part in large}
    top = max(levels.values())
    drop_mm = max(LEAST_MM, PRESSED_SHARE * (top - float(height_mm[counted].min())))
    lower = [part for part in levels if top - levels[part] > drop_mm]
    resting = np.isin(labels, [part for part in levels if part not in lower])
    if hidden:
        lower = [int(np.argmax(sizes[1:])) + 1]
        resting = ring
    pressed = np.isin(labels, lower)
    if (resting | pressed).sum() < FLAT_SHARE * counted.sum():
        return None
    if not hidden and not (ring & pressed).any():
        return None  # The border is at rest, whatever is pressed inside.
    band = ~flat & counted & _near(pressed) & _near(resting)
    if not band.any() or float(np.quantile(tilt_deg[band], STEEP_SHARE)) < BAND_TIMES * flat_deg:
        return None
    border = resting & ring
    if not border.any():
        return None
    up_mm = float(height_mm[border].mean() - height_mm[pressed].mean())
    if up_mm < LEAST_MM:
        return None
    # The tool reaches into the band, as far as the face lies about as deep.
    floor_mm = float(height_mm[pressed].mean())
    tool = pressed | (_near(pressed) & counted & (height_mm < floor_mm + RIM_SHARE * up_mm))
    share = 0.0 if layer is None else bulge_beside(tool, border, grid, layer)
    bulge_mm = up_mm * share / (1.0 + share)
    # A border all of which sinks may lie anywhere above what is pressed.
    sigma_mm = math.hypot(BULGE_SHARE * bulge_mm, HIDDEN_SHARE * hidden * (up_mm - bulge_mm))
    rims = _near(pressed) & _near(resting)
    return RestingPart(resting, pressed, rims, 1e-3 * bulge_mm, 1e-3 * sigma_mm, hidden)


def flat_blocks(tilt_deg: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, float]:
    """Blocks that are flat, bool, [h, w], of those that count, and the tilt below which they are
    [degrees]."""
    quiet = float(np.quantile(tilt_deg[counted], QUIET_SHARE)) if counted.any() else 0.0
    flat_deg = float(np.clip(NOISE_TIMES * quiet, LEAST_FLAT_DEG, MOST_FLAT_DEG))
    return (tilt_deg < flat_deg) & counted, flat_deg


def bulge_beside(
    pressed: np.ndarray, beside: np.ndarray, grid: PixelGrid, layer: BondedLayer
) -> float:
    """Mean rise of blocks ``beside`` over the depth of flat ones that are ``pressed``, both bool,
    [h, w]; what is pressed at the border goes on beyond it."""
    steps = grid.mm_per_px_x, grid.mm_per_px_y
    beyond = [int(BEYOND * layer.thickness_mm / step) + 1 for step in reversed(steps)]
    wide = np.pad(pressed, [(count, count) for count in beyond], mode="edge")
    depth = 0.01 * layer.thickness_mm
    rise = press_layer(np.where(wide, 0.0, FAR_MM), depth, steps, layer, tolerance=0.02).rise_mm
    seen = rise[beyond[0] : -beyond[0], beyond[1] : -beyond[1]]
    return float(np.clip(seen[beside].mean() / depth, *BULGES))


def _parts(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of the connected part of each block, 0 for those that are not flat, and sizes."""
    import cv2

    count, labels = cv2.connectedComponents(flat.astype(np.uint8), connectivity=4)
    return labels, np.bincount(labels.ravel(), minlength=count)


def _ring(shape: tuple[int, ...]) -> np.ndarray:
    ring = np.ones(shape, dtype=bool)
    ring[1:-1, 1:-1] = False
    return ring


def _near(flags: np.ndarray) -> np.ndarray:
    """Flags and what lies within half of ``BAND_BLOCKS`` of them."""
    import cv2

    return cv2.dilate(flags.astype(np.uint8), np.ones((BAND_BLOCKS, BAND_BLOCKS), np.uint8)) > 0
