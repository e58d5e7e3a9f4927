# SPDX-License-Identifier: Apache-2.0
"""What the catalogue knows of a sensor that captures can be held against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile.optical_design import Light
from taccel_lab.sensors.registry import known_sensor, sensor_families, sensor_family

GENERIC = ("flat_pad",)
"""Families that stand for any sensor: their figures contradict nothing."""
PURE = 0.6
"""Share of a lamp's light in its strongest channel above which it counts as of that colour."""


@dataclass(frozen=True)
class SensorFacts:
    """Figures of one family; None where it has none."""

    family: str
    thickness_mm: float | None = None
    view_mm: float | None = None
    """Longer side of what the camera usually shows."""
    image_px: tuple[int, int] | None = None
    """Width and height of its images."""
    handedness: float | None = None
    """Which way round its red, green and blue lamps stand, see ``handedness``."""
    drop_mm: float = 0.0
    """How far the face lies lower at the sides of the view than at its apex."""
    has_markers: bool = False
    is_grey: bool = False
    """Whether all its lamps are white: grey levels stand for depth."""


@cache
def catalogue_view_mm() -> tuple[float, float]:
    """Longer side of what a camera shows [mm] that 95 % of further sensors have, by those of the
    catalogue: Student's prediction interval of its logarithm."""
    families = [family for family in sensor_families().values() if family.name not in GENERIC]
    logs = np.log([_longer_mm(family.parameters().grid()) for family in families])
    reach = student_t.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) * np.sqrt(1 + 1 / len(logs))
    return float(np.exp(logs.mean() - reach)), float(np.exp(logs.mean() + reach))


def _longer_mm(grid: PixelGrid) -> float:
    return max(grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y)


def sensor_facts(name: str, design: Mapping[str, Any] | None = None) -> SensorFacts | None:
    """Figures of the sensor called ``name``, with what ``design`` states otherwise; None when there
    is no such family or profile.

    Raises:
        InputError: The family has no such parameter, or cannot be built so.
    """
    family = known_sensor(name)
    if family is None:
        return None
    parameters = family.parameters(design)
    optics = parameters.optics()
    lamps = [] if optics is None else list(optics.lights)
    grey = bool(lamps) and all(np.ptp(lamp.rgb) < 1e-6 for lamp in lamps)
    if name in GENERIC:
        return SensorFacts(name, is_grey=grey)
    pad = parameters.pad()
    size = np.ptp(pad.bounds_mm(), axis=0)
    grid = parameters.grid()
    return SensorFacts(
        family=name,
        # A shell on a hard dome is thinner than it is high.
        thickness_mm=float(parameters.values().get("thickness_mm", size[2])),
        view_mm=_longer_mm(grid),
        image_px=(grid.width_px, grid.height_px),
        drop_mm=_drop_mm(pad, size, grid),
        handedness=_handedness(lamps),
        has_markers=parameters.markers() is not None,
        is_grey=grey,
    )


def _drop_mm(pad: Any, size_mm: np.ndarray, grid: PixelGrid) -> float:
    """Largest drop [mm] of the points at the middle of the view's sides, or well inside the
    pad's."""
    view = np.array([grid.width_px * grid.mm_per_px_x / 2, grid.height_px * grid.mm_per_px_y / 2])
    x, y = np.minimum(0.4 * size_mm[:2], view)
    sides = np.array([[0.0, 0.0], [x, 0.0], [-x, 0.0], [0.0, y], [0.0, -y]])
    heights = pad.top_mm(sides)
    return float(heights[0] - heights[1:].min())


def _handedness(lamps: list[Light]) -> float | None:
    """Handedness of three lamps of one colour each; None for any other lighting."""
    if len(lamps) != 3:
        return None
    directions = np.zeros((3, 2))
    for lamp in lamps:
        channel = int(np.argmax(lamp.rgb))
        if lamp.rgb[channel] < PURE * sum(lamp.rgb):
            return None
        if lamp.arc_deg < 360:  # The light of a whole ring comes from no side.
            directions[channel] = lamp.position_mm[:2]
    if not np.linalg.norm(directions, axis=1).all():
        return None
    return handedness(directions)


def handedness(lamps: np.ndarray) -> float:
    """Which way round red, green and blue light come, from +3 (clockwise as seen) to -3.

    ``lamps``: directions of the three channels, shape [3, 2] (u, v). Turning the camera leaves it
    as it is; swapping two channels, or mirroring the image, turns its sign.
    """
    unit = lamps / np.maximum(np.linalg.norm(lamps, axis=-1, keepdims=True), 1e-9)
    following = np.roll(unit, -1, axis=0)
    return float((unit[:, 0] * following[:, 1] - unit[:, 1] * following[:, 0]).sum())


SAME_SHAPE = 0.02
"""Difference of two images' proportions up to which they count as of one framing."""
USUAL = "the usual one of the catalogue's {}"
"""Reason of a scale that is taken from the catalogue."""


def catalogue_scale(sensor: str, width_px: int, height_px: int) -> tuple[float, float]:
    """Scale of a sensor's usual view over images of this size, along x and y [mm/px].

    Raises InputError where the images have other proportions, so that they cannot show the same.
    """
    grid = sensor_family(sensor).parameters().grid()
    factor = grid.width_px / width_px

    def alike(width: int, height: int) -> bool:
        return abs(height * grid.width_px / width / grid.height_px - 1) <= SAME_SHAPE

    if not alike(width_px, height_px):
        advice = (
            "they are turned by a quarter: turn the camera back"
            if alike(height_px, width_px)
            else "cut them (capture record has --crop)"
        )
        raise InputError(
            f"--scale catalogue: {sensor} has images of {grid.width_px}x{grid.height_px} px, "
            f"these are {width_px}x{height_px} px and cannot show the same part of the gel; "
            f"{advice}, or state --mm-per-px-x"
        )
    return grid.mm_per_px_x * factor, grid.mm_per_px_y * grid.height_px / height_px
