# SPDX-License-Identifier: Apache-2.0
"""Surface normals inside the contact of a ball, on flat and on curved gels.

Inside the contact the gel has the ball's shape: at distance (x, y) from the point below the ball's
centre the outward normal is ``(-x, -y, sqrt(R^2 - x^2 - y^2)) / R``. On a face that is tilted at
rest the ball's centre stands off the middle of the contact along the resting normal, by
``sqrt(R^2 - a^2)`` for a contact of radius a; the circle in the image is the contact's, and the
ball's centre is found from it.
"""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.geometry import PixelGrid

STEEPEST = 0.9986
"""Largest distance from the centre that gives a normal, in radii: the ball is 87 degrees steep."""


def ball_center_px(
    circle: ContactCircle, grid: PixelGrid, ball_radius_mm: float, rest_normals: np.ndarray | None
) -> tuple[float, float]:
    """Pixel (u, v) below the centre of the ball that touches in ``circle``.

    ``rest_normals`` are those of the undeformed face, shape [height_px, width_px, 3]; flat if None.
    """
    if rest_normals is None:
        return circle.u_px, circle.v_px
    row = int(np.clip(round(circle.v_px), 0, grid.height_px - 1))
    column = int(np.clip(round(circle.u_px), 0, grid.width_px - 1))
    normal = rest_normals[row, column]
    rim_mm = min(circle.radius_px * grid.mm_per_px_x, ball_radius_mm)
    off_mm = math.sqrt(ball_radius_mm**2 - rim_mm**2)
    return (
        circle.u_px + float(normal[0]) * off_mm / grid.mm_per_px_x,
        circle.v_px + float(normal[1]) * off_mm / grid.mm_per_px_y,
    )


def ball_normals(
    circle: ContactCircle,
    grid: PixelGrid,
    ball_radius_mm: float,
    rest_normals: np.ndarray | None = None,
) -> np.ndarray:
    """Outward unit normals of the ball's shape at every pixel, shape [height_px, width_px, 3].

    They hold inside the contact only; beyond the ball's own outline they are as steep as at it.
    """
    u_px, v_px = ball_center_px(circle, grid, ball_radius_mm, rest_normals)
    x = (np.arange(grid.width_px)[None, :] - u_px) * grid.mm_per_px_x / ball_radius_mm
    y = (np.arange(grid.height_px)[:, None] - v_px) * grid.mm_per_px_y / ball_radius_mm
    x, y = np.broadcast_arrays(x, y)
    distance = np.hypot(x, y)
    shrink = np.minimum(1.0, STEEPEST / np.maximum(distance, 1e-12))
    x, y = x * shrink, y * shrink
    return np.stack([-x, -y, np.sqrt(1.0 - x**2 - y**2)], axis=-1)
