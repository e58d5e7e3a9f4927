# SPDX-License-Identifier: Apache-2.0
"""Presses that follow the slope law exactly, under lamps whose response is no polynomial."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.circles.labels import DetectedContact, circle_array
from taccel_lab.calibration.circles.press_model import SINK_IN_SCALE, slope_law
from taccel_lab.calibration.circles.usable import usable_presses
from taccel_lab.geometry import PixelGrid
from tests.support.synthetic_presses import memory_captures

GRID = PixelGrid(200, 150, 0.08, 0.08)
BALL_MM = 2.4
BALL_PX = BALL_MM / GRID.mm_per_px_x


def gel(grid: PixelGrid = GRID) -> np.ndarray:
    """Background, RGB levels, shape [height_px, width_px, 3]."""
    u, v = np.meshgrid(np.linspace(0, 1, grid.width_px), np.linspace(0, 1, grid.height_px))
    return np.stack([100 + 20 * u, 120 - 15 * v, 95 + 20 * u * v], axis=-1)


def pressed(
    circle: ContactCircle,
    grid: PixelGrid = GRID,
    *,
    ball_px: float = BALL_PX,
    blur_px: float = 1.0,
    falloff: float = 0.3,
    sink_in: float = SINK_IN_SCALE,
) -> np.ndarray:
    """Levels of a press without noise: three lamps, falling off over the image."""
    ratio = grid.mm_per_px_y / grid.mm_per_px_x
    du = np.arange(grid.width_px)[None, :] - circle.u_px
    dv = (np.arange(grid.height_px)[:, None] - circle.v_px) * ratio
    distance = np.hypot(du, dv) + 1e-12
    reach_px = float(distance.max()) + 1
    normal, drop = slope_law(distance, circle.radius_px, ball_px, blur_px, reach_px, sink_in)[0]
    up = np.sqrt(1 - normal**2)
    light = np.linspace(1 - falloff, 1 + falloff, grid.width_px)[None, :]
    image = gel(grid)
    for k in range(3):
        turn = 2 * np.pi * k / 3
        tilt = normal * (du * np.cos(turn) + dv * np.sin(turn)) / distance
        shade = 0.5 * tilt + 0.87 * up
        image[..., k] += 70 * light * (shade - 0.87) - 4 * drop
    return image


def press_set(
    circles: list[ContactCircle], images: list[np.ndarray], grid: PixelGrid = GRID
) -> CaptureSet:
    """A capture set in memory; images are levels of any type."""
    return memory_captures(circles, images, gel(grid), grid, BALL_MM)


def scattered(count: int, seed: int = 0, grid: PixelGrid = GRID) -> list[ContactCircle]:
    """Contacts well inside the image."""
    rng = np.random.default_rng(seed)
    ratio = grid.mm_per_px_x / grid.mm_per_px_y
    return [
        ContactCircle(
            float(rng.uniform(45, grid.width_px - 45)),
            float(rng.uniform(45 * ratio, grid.height_px - 45 * ratio)),
            float(rng.uniform(17, 25)),
        )
        for _ in range(count)
    ]


def offsets(captures: CaptureSet, contacts: Sequence[DetectedContact]) -> np.ndarray:
    """Found minus given u, v, radius of each press [px], shape [n, 3]."""
    given = [press.circle for press in captures.presses if press.circle is not None]
    return circle_array([contact.circle for contact in contacts]) - circle_array(given)


def contacts_of(captures: CaptureSet) -> list[DetectedContact]:
    """Contacts of the presses as the calibrations find them."""
    return usable_presses(captures)[1]
