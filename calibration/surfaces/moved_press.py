# SPDX-License-Identifier: Apache-2.0
"""A simulated press moved a little: elsewhere by some pixels, with a contact a little larger.

What the simulation gave against the gel at rest is shifted as it is, so that the lean of a crowned
gel stays in; the change with the contact radius is that of the radial profiles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.surfaces.press_surface import BallSurface, slope_of
from taccel_lab.calibration.surfaces.radial import RadialSurfaces
from taccel_lab.signals.normals import normals_from_slopes

_MAX_TILT = math.radians(88.0)


@dataclass(frozen=True)
class MovedPress:
    """A simulated press that can be asked for at other circles."""

    circle: ContactCircle
    """Where it was simulated, with the radius that the simulation reached."""
    library: RadialSurfaces
    tilt: np.ndarray
    """dh/dx, dh/dy against the gel at rest and displacement [mm], shape [3, rows, columns]."""
    origin: tuple[int, int]
    """Row and column of the arrays' first pixel in the image."""

    @classmethod
    def of(
        cls,
        surface: BallSurface,
        circle: ContactCircle,
        library: RadialSurfaces,
        reach_radii: float = 3.0,
    ) -> MovedPress:
        """Of a simulated press, known as far as ``reach_radii`` around it."""
        grid = library.grid
        half = reach_radii * surface.contact_radius_px
        half_v = half * grid.mm_per_px_x / grid.mm_per_px_y
        top = max(0, math.floor(circle.v_px - half_v))
        left = max(0, math.floor(circle.u_px - half))
        window = (
            slice(top, math.ceil(circle.v_px + half_v) + 1),
            slice(left, math.ceil(circle.u_px + half) + 1),
        )
        slope = slope_of(surface.normals[window]) - slope_of(surface.rest_normals[window])
        sunk = surface.displacement_mm()[window]
        return cls(
            ContactCircle(circle.u_px, circle.v_px, surface.contact_radius_px),
            library,
            np.concatenate([np.moveaxis(slope, -1, 0), sunk[None]]),
            (top, left),
        )

    def at(self, circle: ContactCircle, pixel_idx: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normals [pixel, 3] and displacement [mm] [pixel] as if simulated at ``circle``.

        ``pixel_idx`` counts along rows; pixels should lie within reach of the simulated press.
        """
        grid = self.library.grid
        u, v = pixel_idx % grid.width_px, pixel_idx // grid.width_px
        place = np.stack(
            [
                v - (circle.v_px - self.circle.v_px) - self.origin[0],
                u - (circle.u_px - self.circle.u_px) - self.origin[1],
            ]
        )
        slope_x, slope_y, sunk = (
            map_coordinates(layer, place, order=1, mode="nearest") for layer in self.tilt
        )
        x = (u - circle.u_px) * grid.mm_per_px_x
        y = (v - circle.v_px) * grid.mm_per_px_y
        distance = np.maximum(np.hypot(x, y), 1e-9)
        before = self.library.profiles_at(self.circle.radius_px, distance)
        after = self.library.profiles_at(circle.radius_px, distance)
        toward = (slope_x * x + slope_y * y) / distance
        tilt = np.clip(np.arctan(toward) + after[0] - before[0], -_MAX_TILT, _MAX_TILT)
        change = (np.tan(tilt) - toward) / distance
        rest = self.library.rest_slope.reshape(-1, 2)[pixel_idx]
        slope = rest + np.stack([slope_x, slope_y], axis=-1)
        slope += change[:, None] * np.stack([x, y], axis=-1)
        return normals_from_slopes(slope), sunk + after[1] - before[1]
