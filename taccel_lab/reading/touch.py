# SPDX-License-Identifier: Apache-2.0
"""What one image shows: the surface, and where the gel is touched, decided once for each image, for
all figures of a contact.

A place counts as touched where the surface lies deeper than the reading and the image's light may
be off by. Errors of heights are smooth, so that what is surely deeper has to be a spot as wide as
any contact; all around it that is deeper than errors in 95 % of images belongs to it, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.heights import BAND_SIGMAS
from taccel_lab.summary import Summary
from taccel_lab.with_error import NORMAL_95, with_error

STEEP_SHARE = 0.02
"""Share of pixels that the calibration says nothing of, from which on a user is warned."""
SigmaOf = Literal["absolute depth", "reading alone"]
NO_SIGMA = (
    "the profile does not say how uncertain its depths are: it was calibrated by an earlier "
    "version or without synthetic presses; calibrate again"
)
READING_ALONE = (
    "the profile was calibrated by an earlier version: its +- is that of the reading alone, and "
    "absolute depths are off by more; calibrate again to have it whole"
)


CONTACT_MM = 0.05
CONTACT_SHARE = 0.1
"""Pixels pressed deeper than this and than this share of the deepest one may count as touched."""
SURE_SIGMAS = 3.0
"""Standard deviations by which a place is surely deeper. Of the many places of an image that may
err by themselves, one in four images has one beyond 2 standard deviations, one in forty beyond
3."""
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

    @property
    def any(self) -> bool:
        """Whether anything touches."""
        return bool(self.pixels.any())


def touch_of(rise_m: np.ndarray, sigma_m: np.ndarray | None, grid: PixelGrid) -> Touch:
    """Decide it.

    Args:
        rise_m: Rise over the resting face [m], negative in a dent, shape [h, w] of ``grid``.
        sigma_m: Its standard deviation where nothing touches [m], shape [h, w]; None where the
            profile does not state one: depths above ``CONTACT_MM`` then count.
        grid: Pixel grid of both.
    """
    import cv2

    depth_mm = -1e3 * rise_m
    sigma_mm = np.zeros_like(depth_mm) if sigma_m is None else 1e3 * sigma_m
    deepest = float(depth_mm.max())
    least_mm = max(CONTACT_MM, CONTACT_SHARE * deepest)
    sure_mm = np.maximum(SURE_SIGMAS * sigma_mm, CONTACT_MM)
    wide = (depth_mm > least_mm) & (depth_mm > BAND_SIGMAS * sigma_mm)
    sure = depth_mm > sure_mm
    count, parts = cv2.connectedComponents(wide.astype(np.uint8))
    spots = np.bincount(parts[sure & wide], minlength=count)
    touched = spots * grid.mm_per_px_x * grid.mm_per_px_y >= LEAST_MM2
    touched[0] = False
    pixels = touched[np.asarray(parts, dtype=int)]
    unseen_mm = float((np.maximum(depth_mm, 0.0) + BAND_SIGMAS * sigma_mm).max())
    return Touch(pixels, least_mm, max(unseen_mm, CONTACT_MM))


@dataclass(frozen=True, repr=False, kw_only=True)
class SurfaceReading(Summary):
    """What one image shows."""

    height_m: np.ndarray
    """z of the contact face [m], gel frame, shape [height_px, width_px]: where nothing touches, z
    of the resting face, which is curved on some sensors."""
    depth_m: np.ndarray
    """How far the face lies below where it rests [m], positive in a dent, negative where the gel
    bulges; 0 where nothing touches, also on a curved gel."""
    height_sigma_m: np.ndarray | None
    """Standard deviation of height and depth [m]. None of models that were fitted without synthetic
    presses, and of curves of earlier versions."""
    reading_sigma_m: np.ndarray | None
    """Standard deviation of a place if nothing touches [m], by the reading and the image's light:
    what is off along with a depth, such as the calibration's circles or scale, is not in it."""
    normals: np.ndarray
    """Outward unit normals, shape [height_px, width_px, 3]."""
    sigma_deg: np.ndarray | None = None
    """Standard deviation of each component of the tilt [degrees]; None of a grey sensor."""
    radius95_deg: np.ndarray | None = None
    """Angle within which 95 % of the true normals lie [degrees]; None of a grey sensor."""
    beyond_balls: np.ndarray | None = None
    """Pixels that read steeper than any captured ball was, bool: their slopes are what the colour
    model makes of colours that nobody captured. None of a grey sensor."""
    saturated: np.ndarray | None = None
    """Pixels darker than any that was calibrated, bool; None of a colour sensor."""
    method: Literal["normals", "depth"]
    touch: Touch
    """Where the gel is touched: the one decision that area, pressure and force follow."""
    sigma_of: SigmaOf | None = None
    """What ``height_sigma_m`` is that of: the absolute depth, or, with profiles of earlier versions
    that know no more, the reading alone; None where the profile tells none."""
    remarks: tuple[str, ...] = ()
    """What the profile says of itself, such as that it is of another unit."""

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """How deep the gel is pressed, and by which model."""
        height, width = self.depth_m.shape
        return f"surface read from {self.method}", [
            ("deepest", self.depth_words),
            ("pixels", f"{width} x {height}"),
            *(("note", remark) for remark in self.remarks),
        ]

    @property
    def deepest_px(self) -> tuple[int, int]:
        """Row and column of the deepest place that is touched; of the image where nothing is."""
        depth = self.depth_m
        if self.touch.any:
            depth = np.where(self.touch.pixels, depth, -np.inf)
        row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
        return int(row), int(column)

    @property
    def depth_interval_mm(self) -> tuple[float, float] | None:
        """95 % interval of the deepest place [mm], from 0 where nothing touches; None where the
        profile states no deviation."""
        if self.height_sigma_m is None:
            return None
        if not self.touch.any:
            return 0.0, self.touch.unseen_mm
        at = self.deepest_px
        depth, off = 1e3 * float(self.depth_m[at]), NORMAL_95 * 1e3 * float(self.height_sigma_m[at])
        return max(depth - off, 0.0), depth + off

    @property
    def depth_words(self) -> str:
        """Depth and its standard deviation, or that nothing touches, in words."""
        row, column = self.deepest_px
        if not self.touch.any:
            return f"no contact deeper than {self.touch.unseen_mm:.2g} mm"
        sigma_m = None if self.height_sigma_m is None else self.height_sigma_m[row, column]
        depth = with_error(
            1e3 * self.depth_m[row, column], None if sigma_m is None else 1e3 * sigma_m
        )
        return f"{depth} mm at ({column}, {row}) px"

    def figures(self, grid: PixelGrid) -> dict[str, Any]:
        """Depth, place and size of what is pressed in, ready for JSON; ``grid`` is the maps'."""
        depth_mm = 1e3 * self.depth_m
        row, column = self.deepest_px
        touched = self.touch.pixels
        pixel_mm2 = grid.mm_per_px_x * grid.mm_per_px_y
        at_mm = grid.gel_from_pixel(np.array([column, row], dtype=float))
        found: dict[str, Any] = {
            "method": self.method,
            "touched": self.touch.any,
            "depth_words": self.depth_words,
            "max_depth_mm": float(depth_mm[row, column]) if self.touch.any else 0.0,
            "max_depth_interval95_mm": self.depth_interval_mm and list(self.depth_interval_mm),
            "max_depth_sigma_mm": None
            if self.height_sigma_m is None
            else float(1e3 * self.height_sigma_m[row, column]),
            "sigma_of": self.sigma_of,
            "deepest_px": [int(column), int(row)],
            "deepest_gel_mm": [float(at_mm[0]), float(at_mm[1])],
            "touched_mm2": float(touched.sum() * pixel_mm2),
            "touched_deeper_than_mm": self.touch.least_mm,
            "volume_mm3": float(depth_mm[touched].sum() * pixel_mm2),
        }
        inside = touched if touched.any() else np.ones_like(touched)
        if self.sigma_deg is not None:
            found["sigma_deg"] = float(self.sigma_deg[inside].mean())
        if self.radius95_deg is not None:
            found["radius95_deg"] = float(self.radius95_deg[inside].mean())
        if self.height_sigma_m is not None:
            found["depth_sigma_mm"] = float(1e3 * self.height_sigma_m[inside].mean())
        if self.beyond_balls is not None:
            found["beyond_balls_share"] = float(self.beyond_balls[inside].mean())
        if self.saturated is not None:
            found["saturated_share"] = float(self.saturated.mean())
        found["warnings"] = self._warnings(found)
        return found

    def _warnings(self, figures: dict[str, Any]) -> list[str]:
        """What a user should know before trusting the heights, one sentence each."""
        said = list(self.remarks)
        if self.sigma_of != "absolute depth":
            said.append(NO_SIGMA if self.sigma_of is None else READING_ALONE)
        steep = figures.get("beyond_balls_share", 0.0)
        if steep > STEEP_SHARE:
            said.append(
                f"{steep:.0%} of what is touched is steeper than any ball that was captured; its "
                "slopes are a guess from the colour model (beyond_balls marks them)"
            )
        if figures.get("saturated_share", 0.0) > STEEP_SHARE:
            said.append(
                f"{figures['saturated_share']:.0%} of the image is darker than any press that was "
                "captured; it is at least as deep as it reads"
            )
        return said
