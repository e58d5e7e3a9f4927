# SPDX-License-Identifier: Apache-2.0
"""Place and depth of the press that a reading shows, with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from taccel_lab.calibration.normals.read_surface import SurfaceReading
    from taccel_lab.geometry import PixelGrid

_CORE = 0.5
"""Share of the deepest place above which the gel follows the indenter: its middle is the press's.
The gel's slope around it would draw the middle towards the side with more gel."""
_CURVED_TO = 0.5
"""Part of a curved gel's lean that is uncertain. A tool touches a slope beside its axis, where it
comes straight down; presses on a GelSight's dome are found up to half of that from the contacts
that a person marked."""


@dataclass(frozen=True)
class SeenPress:
    """The middle of what is pressed in, and how deep it is."""

    at_mm: tuple[float, float]
    """Gel x and y [mm] of the middle of the dent's core, weighed by depth."""
    depth_mm: float
    """Deepest place below the resting face [mm]."""
    at_sigma_mm: tuple[float, float] | None
    """Standard deviations of x and y; None where the profile states none of heights."""
    depth_sigma_mm: float | None
    """That of the depth; None likewise."""
    whole: bool
    """Whether the image shows all of the core."""

    @classmethod
    def of(cls, reading: SurfaceReading, grid: PixelGrid) -> SeenPress | None:
        """The deepest press of a reading; None where nothing touches.

        Errors of heights are smooth, and move the middle most where they lean: those of the place
        are what it moves by if the dent leans by one deviation of the reading from its middle to
        its rim, twice the standard deviation of the core's pixels, and by a part of the gel's own
        lean at rest.
        """
        touched = reading.touch.pixels
        if not touched.any():
            return None
        depth_mm = -1e3 * reading.rise_m
        core, middle_px = _core(depth_mm, touched)
        middle = grid.gel_from_pixel(middle_px)
        at_sigma = depth_sigma = None
        if reading.height_sigma_m is not None and reading.reading_sigma_m is not None:
            depth_sigma = float(1e3 * reading.height_sigma_m[reading.deepest_px])
            at_sigma = _place_sigma(reading, depth_mm, core, grid)
        edge = np.concatenate([core[0], core[-1], core[:, 0], core[:, -1]])
        deepest_mm = float(depth_mm[reading.deepest_px])
        x, y = middle
        return cls((float(x), float(y)), deepest_mm, at_sigma, depth_sigma, not edge.any())


def _core(depth_mm: np.ndarray, touched: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels around the deepest of those that are touched, bool, and their middle [px], [2]."""
    from scipy import ndimage

    deepest = int(np.where(touched, depth_mm, -np.inf).argmax())
    parts, _ = ndimage.label(depth_mm > _CORE * depth_mm.ravel()[deepest])  # type: ignore[misc]
    core = parts == parts.ravel()[deepest]
    return core, np.array(ndimage.center_of_mass(depth_mm * core)[::-1])


def _place_sigma(
    reading: SurfaceReading, depth_mm: np.ndarray, core: np.ndarray, grid: PixelGrid
) -> tuple[float, float]:
    """How far the middle moves in x and y [mm] where the dent leans along each."""
    assert reading.reading_sigma_m is not None
    sigma_mm = 1e3 * float(reading.reading_sigma_m[core].mean())
    rest_mm = 1e3 * (reading.height_m - reading.rise_m)
    touched = reading.touch.pixels
    middle = _core(depth_mm, touched)[1]
    found = []
    for axis, step_mm in enumerate((grid.mm_per_px_x, grid.mm_per_px_y)):
        places = np.indices(core.shape)[1 - axis]
        rim_px = max(2 * float(places[core].std()), 1.0)
        own_mm = rim_px * float(np.gradient(rest_mm, axis=1 - axis)[core].mean())
        lean_mm = np.hypot(sigma_mm, _CURVED_TO * own_mm)
        leaning = depth_mm + lean_mm * (places - middle[axis]) / rim_px
        found.append(step_mm * abs(float(_core(leaning, touched)[1][axis] - middle[axis])))
    return found[0], found[1]
