# SPDX-License-Identifier: Apache-2.0
"""Where the gel is touched, decided once for each image, for all figures of a contact.

A place counts as touched where the surface lies deeper than the reading and the image's light may
be off by. Errors of heights are smooth, so that what is surely deeper has to be a spot as wide as
any contact; all around it that is deeper than errors in 95 % of images belongs to it, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.heights import BAND_SIGMAS
from taccel_lab.with_error import NORMAL_95

CONTACT_MM = 0.02
CONTACT_SHARE = 0.1
"""Pixels pressed deeper than this and than this share of the deepest one may count as touched."""
FLAT_SHARE = 0.3
"""Likewise of the deepest one, of places that a flat tool's rim shows to be pressed."""
SURE_SIGMAS = 3.0
"""Standard deviations by which a place is surely deeper. Of the many places of an image that may
err by themselves, one in four images has one beyond 2 standard deviations, one in forty beyond
3."""
CHOSEN_SIGMAS = 3.5
"""The same of the deepest place of an image, which may otherwise be 0 deep: one of 200."""
LEAST_MM2 = 0.05
"""Area of the smallest spot that is surely deeper: a ball of 1 mm, 0.02 mm deep, touches more."""


@dataclass(frozen=True)
class Touch:
    """What of an image shows a contact."""

    pixels: np.ndarray
    """Touched ones, bool, shape [height_px, width_px]."""
    least_mm: float
    """Depth that a touched pixel has at least [mm]."""
    unseen_mm: float
    """Upper end [mm] of the 95 % interval of a depth anywhere in the image, where none is seen."""
    most_mm2: float = 0.0
    """Area of all that lies lower than a share of the deepest place and hangs together with what is
    touched [mm2]: no contact is larger."""

    @property
    def any(self) -> bool:
        """Whether anything touches."""
        return bool(self.pixels.any())


def touch_of(
    rise_m: np.ndarray,
    sigma_m: np.ndarray | None,
    grid: PixelGrid,
    pressed: np.ndarray | None = None,
) -> Touch:
    """Decide it.

    Args:
        rise_m: Rise over the resting face [m], negative in a dent, shape [h, w] of ``grid``.
        sigma_m: Its standard deviation where nothing touches [m], shape [h, w]; None where the
            profile does not state one: depths above ``CONTACT_MM`` then count.
        grid: Pixel grid of both.
        pressed: Flat places that surely lie lower than what is at rest, bool, shape [h, w]: their
            rim in the image shows it (``rest``). None of none.
    """
    import cv2

    depth_mm = -1e3 * rise_m
    sigma_mm = np.zeros_like(depth_mm) if sigma_m is None else 1e3 * sigma_m
    deepest = float(depth_mm.max())
    least_mm = max(CONTACT_MM, CONTACT_SHARE * deepest)
    sure_mm = np.maximum(SURE_SIGMAS * sigma_mm, CONTACT_MM)
    wide = (depth_mm > least_mm) & (depth_mm > BAND_SIGMAS * sigma_mm)
    sure = depth_mm > sure_mm
    if pressed is not None:
        least_mm = min(least_mm, FLAT_SHARE * max(deepest, 0.0))
        flat = pressed & (depth_mm > least_mm)
        wide, sure = wide | flat, sure | flat
    count, parts = cv2.connectedComponents(wide.astype(np.uint8))
    spots = np.bincount(parts[sure & wide], minlength=count)
    touched = spots * grid.mm_per_px_x * grid.mm_per_px_y >= LEAST_MM2
    touched[0] = False
    pixels = touched[np.asarray(parts, dtype=int)]
    unseen_mm = float((np.maximum(depth_mm, 0.0) + BAND_SIGMAS * sigma_mm).max())
    most_mm2 = 0.0
    if pixels.any():
        _, parts = cv2.connectedComponents((depth_mm > CONTACT_SHARE * deepest).astype(np.uint8))
        parts = np.asarray(parts, dtype=int)
        touched = np.bincount(parts[pixels], minlength=int(parts.max()) + 1) > 0
        most_mm2 = float(touched[parts].sum()) * grid.mm_per_px_x * grid.mm_per_px_y
    return Touch(pixels, least_mm, max(unseen_mm, CONTACT_MM), most_mm2)


def least_logs(depth: float, sigma: float, alone: float) -> tuple[float, float]:
    """Logarithms of the factors that a depth may be lower by with 95 %, by what is added to it and
    by what grows with it; endless where it may be 0.

    What else is off than the reading and the light (circles, scale, the gel beside a wide tool)
    grows with the depth: it makes no touch of none, and none of a touch.

    Args:
        depth: Of the deepest place.
        sigma: Its standard deviation, in the same unit.
        alone: The part of it by the reading and the light, which adds.
    """
    if depth <= CHOSEN_SIGMAS * alone:
        return math.inf, 0.0
    shared = math.sqrt(max(sigma**2 - alone**2, 0.0))
    return -math.log(1.0 - NORMAL_95 * alone / depth), NORMAL_95 * shared / depth


def likely_touched(rise_m: np.ndarray, sigma_m: np.ndarray | None, beside: int) -> np.ndarray:
    """Pixels of a coarse map that may be touched, or lie so many pixels beside one, bool, [h, w]:
    half the depth that counts, since a small contact is averaged with its surroundings; arguments
    as of ``touch_of``."""
    import cv2

    depth_m = -rise_m
    least_m = np.full(depth_m.shape, 0.5e-3 * CONTACT_MM)
    if sigma_m is not None:
        least_m = np.maximum(least_m, BAND_SIGMAS * sigma_m)
    size = 2 * beside + 1
    return cv2.dilate((depth_m > least_m).astype(np.uint8), np.ones((size, size), np.uint8)) > 0
