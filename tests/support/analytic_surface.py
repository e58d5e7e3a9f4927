# SPDX-License-Identifier: Apache-2.0
"""Closed-form ball presses, from which tests draw their pictures.

The sphere's cap in the contact circle is continued with the sinking of an elastic half-space
outside a Hertz contact, K. L. Johnson, Contact Mechanics (1985), eq. 3.42a:
``u_z(r) ~ (2 a^2 - r^2) asin(a / r) + a^2 (r/a) sqrt(1 - a^2/r^2)``, here scaled so that the
slope is continuous with the sphere's at the contact's rim and damped by ``exp(-(r - a) / l)``,
since a gel bonded to a plate sinks over a distance of about its thickness only.
"""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.circles.press_model import hertz_slope
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

MAX_SLOPE = 2.5
"""Steepest slope of the skirt's start; a sphere's grows without bound towards its equator."""


def analytic_surface(
    circle: ContactCircle, grid: PixelGrid, ball_radius_mm: float, *, decay_mm: float = math.inf
) -> BallSurface:
    """Surface of a flat gel under a ball that touches it in ``circle``.

    ``decay_mm`` is the damping length of the Hertz skirt [mm]; infinite is the half-space.
    """
    rim_mm = circle.radius_px * grid.mm_per_px_x
    if rim_mm >= ball_radius_mm:
        raise InputError(
            f"contact radius {rim_mm:.3f} mm is not below the ball's radius {ball_radius_mm:g} mm"
        )
    du = (np.arange(grid.width_px)[None, :] - circle.u_px) * grid.mm_per_px_x
    dv = (np.arange(grid.height_px)[:, None] - circle.v_px) * grid.mm_per_px_y
    distance_mm = np.hypot(du, dv)
    radii = np.linspace(0.0, distance_mm.max() + 1.0, 8192)
    slope = _slope(radii, rim_mm, ball_radius_mm, decay_mm)
    # Heights by integrating the slope; the far field is at rest level.
    steps = 0.5 * (slope[1:] + slope[:-1]) * np.diff(radii)
    height_mm = np.concatenate([[0.0], np.cumsum(steps)])
    height_mm -= height_mm[-1]
    pixel_slope = np.interp(distance_mm, radii, slope)
    toward = np.divide(1.0, distance_mm, out=np.zeros_like(distance_mm), where=distance_mm > 0)
    normals = np.stack(
        [-pixel_slope * du * toward, -pixel_slope * dv * toward, np.ones_like(distance_mm)], axis=-1
    )
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    shape = (grid.height_px, grid.width_px)
    return BallSurface(
        height_m=np.interp(distance_mm, radii, height_mm) * 1e-3,
        rest_height_m=np.zeros(shape),
        normals=normals,
        rest_normals=np.broadcast_to(np.array([0.0, 0.0, 1.0]), (*shape, 3)),
        depth_mm=float(-height_mm[0]),
        provider="analytic hertz" + ("" if math.isinf(decay_mm) else f", decay {decay_mm:g} mm"),
    )


def _slope(
    radii_mm: np.ndarray, rim_mm: float, ball_radius_mm: float, decay_mm: float
) -> np.ndarray:
    """dh/dr of the surface at each radius, shape as ``radii_mm``."""
    inside = radii_mm <= rim_mm
    slope = np.zeros_like(radii_mm)
    r = radii_mm[inside]
    slope[inside] = r / np.sqrt(ball_radius_mm**2 - r**2)
    shape = hertz_slope(radii_mm[~inside] / rim_mm)
    rim_slope = min(rim_mm / math.sqrt(ball_radius_mm**2 - rim_mm**2), MAX_SLOPE)
    slope[~inside] = rim_slope * shape * np.exp(-(radii_mm[~inside] - rim_mm) / decay_mm)
    return slope
