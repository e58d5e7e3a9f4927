# SPDX-License-Identifier: Apache-2.0
"""Surfaces of presses between those that were simulated: any place, any contact radius.

Around a ball press a flat or gently curved gel is nearly round, so the simulated presses are
averaged around their centres: the tilt against the gel at rest and the displacement in contact
radii, both over the distance in contact radii. Polynomials in the contact radius join the presses.
The tilt is taken as an angle, which stays finite up to the ball's equator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.surfaces.press_surface import BallSurface, slope_of
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

REACH = 4.0
"""How far the profiles go, in contact radii; beyond, the gel is taken as at rest."""
STEP = 0.025
"""Distance of their samples in contact radii."""
MARGIN = 0.15
"""How far beyond the simulated contact radii a radius may lie, as a share of them."""


@dataclass(frozen=True)
class RadialSurfaces:
    """Tilt and displacement around a press as polynomials of the contact radius."""

    tilt_rad: np.ndarray
    """Coefficients, highest power first, shape [degree + 1, sample]."""
    sunk_per_radius: np.ndarray
    """The same for the displacement over the contact radius."""
    middle_px: float
    """Contact radius at which the polynomials' variable is zero [px]."""
    radius_range_px: tuple[float, float]
    """Contact radii that surfaces can be had for [px]."""
    rest_slope: np.ndarray
    """dh/dx and dh/dy of the gel at rest, shape [height_px, width_px, 2]."""
    grid: PixelGrid

    @classmethod
    def of(
        cls,
        surfaces: Sequence[BallSurface],
        circles: Sequence[ContactCircle],
        grid: PixelGrid,
    ) -> RadialSurfaces:
        """From simulated presses: their surfaces and where they are.

        The radii are those that the simulation reached.
        """
        if not surfaces:
            raise InputError("radial profiles need at least one surface")
        radii = np.array([surface.contact_radius_px for surface in surfaces])
        profiles = [
            _profile(surface, circle, grid)
            for surface, circle in zip(surfaces, circles, strict=True)
        ]
        spread = float(np.ptp(radii) / radii.mean())
        degree = 0 if spread < 0.03 or len(radii) < 3 else 1 if len(radii) < 6 else 2
        variable = radii / radii.mean() - 1.0
        tilt, sunk = (np.stack([p[k] for p in profiles]) for k in (0, 1))
        return cls(
            tilt_rad=np.polyfit(variable, tilt, degree),
            sunk_per_radius=np.polyfit(variable, sunk, degree),
            middle_px=float(radii.mean()),
            radius_range_px=(
                float(radii.min() * (1 - MARGIN)),
                float(radii.max() * (1 + MARGIN)),
            ),
            rest_slope=slope_of(surfaces[0].rest_normals),
            grid=grid,
        )

    def profiles_at(
        self, radius_px: float, distance_mm: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Tilt towards the outside [rad] and displacement [mm] at distances from the centre [mm].

        The radius is brought into ``radius_range_px``.
        """
        radius_px = float(np.clip(radius_px, *self.radius_range_px))
        radius_mm = radius_px * self.grid.mm_per_px_x
        variable = radius_px / self.middle_px - 1.0
        t = np.arange(self.tilt_rad.shape[1]) * STEP
        relative = distance_mm / radius_mm
        tilt = np.interp(relative, t, np.polyval(self.tilt_rad, variable), right=0.0)
        sunk = np.interp(relative, t, np.polyval(self.sunk_per_radius, variable), right=0.0)
        return tilt, sunk * radius_mm


def _profile(
    surface: BallSurface, circle: ContactCircle, grid: PixelGrid
) -> tuple[np.ndarray, np.ndarray]:
    """Mean tilt [rad] and displacement per contact radius around a press, shape [sample]."""
    count = round(REACH / STEP) + 1
    away = circle.distance_px(grid) / surface.contact_radius_px
    near = away < (count - 0.5) * STEP
    slope = (slope_of(surface.normals) - slope_of(surface.rest_normals))[near]
    v, u = np.nonzero(near)
    x = (u - circle.u_px) * grid.mm_per_px_x
    y = (v - circle.v_px) * grid.mm_per_px_y
    distance = np.maximum(np.hypot(x, y), 1e-9)
    tilt = np.arctan((slope[:, 0] * x + slope[:, 1] * y) / distance)
    sunk = surface.displacement_mm()[near] / (surface.contact_radius_px * grid.mm_per_px_x)
    # Each pixel counts for the two samples that it lies between.
    place = away[near] / STEP
    low = place.astype(int)
    share = place - low
    total = np.zeros(count + 1)
    sums = np.zeros((2, count + 1))
    for index, weight in ((low, 1 - share), (low + 1, share)):
        np.add.at(total, index, weight)
        np.add.at(sums[0], index, weight * tilt)
        np.add.at(sums[1], index, weight * sunk)
    seen = total[:count] > 0
    t = np.arange(count)
    means = [
        np.interp(t, t[seen], row[:count][seen] / total[:count][seen], right=0.0) for row in sums
    ]
    means[0][0] = 0.0
    return means[0], means[1]
