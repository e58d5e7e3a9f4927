# SPDX-License-Identifier: Apache-2.0
"""LEDs and light guides as a fixed set of points: one in the middle of each of equal cells.

The set is the same for every pixel and frame, so that two renders of one design are equal and the
difference of two frames holds no noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.profile.optical_design import Light

_LEAST_CELL_MM = 1.0
"""Smallest cell of lights beside the contact face, where depth says nothing of how far the gel
is."""


@dataclass(frozen=True)
class LightSamples:
    """Points that stand for the lights."""

    positions_mm: np.ndarray
    """Shape [sample, 3]."""
    axes: np.ndarray
    """Unit axis of emission, shape [sample, 3]."""
    intensities: np.ndarray
    """Power per solid angle on the axis by channel, shape [sample, 3]."""
    lobes: np.ndarray
    """Exponent of the lobe, shape [sample]."""


def sample_lights(lights: tuple[Light, ...], samples: int) -> LightSamples:
    """Cut each area light into cells as near to squares as can be, at most ``samples`` of them.

    Exits of light guides, far longer than an LED, are cut into more, until no cell is longer than
    a quarter of the light's depth behind the gel's apex: the light of a line on a plane, all over
    it, is then that of its closed form to 1 % (``tests/optics/test_light_guides.py``).

    A lobe cos^n of power P has the axial intensity P (n + 1) / (2 pi), so that its integral over
    the half-space is P.
    """
    positions, axes, intensities, lobes = [], [], [], []
    for light in lights:
        points, directions = (
            _bent_cells(light, samples) if light.arc_deg else _cells(light, samples)
        )
        count = len(points)
        axial = np.array(light.rgb) * (light.lobe + 1) / (2 * math.pi) / count
        positions.append(points)
        axes.append(directions)
        intensities.append(np.tile(axial, (count, 1)))
        lobes.append(np.full(count, light.lobe))
    return LightSamples(*map(np.concatenate, (positions, axes, intensities, lobes)))


def emitter_axes(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions of an emitting face's width and height; the width lies in the xy plane."""
    direction = np.asarray(direction, dtype=np.float64)
    width = np.array([-direction[1], direction[0], 0.0])
    length = np.linalg.norm(width)
    width = width / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return width, np.cross(direction, width)


def _cells(light: Light, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres [mm] and axes of the cells of a straight face, [cell, 3] each."""
    columns, rows = _counts(light.size_mm, samples, _longest_mm(light))
    width, height = emitter_axes(np.array(light.direction))
    across = _middles(columns) * light.size_mm[0]
    along = _middles(rows) * light.size_mm[1]
    grid = across[None, :, None] * width + along[:, None, None] * height
    points = np.array(light.position_mm) + grid.reshape(-1, 3)
    return points, np.tile(light.direction, (len(points), 1))


def _bent_cells(light: Light, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """The same of a face that is bent about the gel's z axis."""
    place, direction = np.array(light.position_mm), np.array(light.direction)
    arc, height_mm = math.radians(light.arc_deg), light.size_mm[1]
    length_mm = arc * math.hypot(*place[:2])
    columns, rows = _counts((length_mm, height_mm), samples, _longest_mm(light))
    tangent = np.array([-place[1], place[0], 0.0])
    tangent -= (tangent @ direction) * direction
    height = np.cross(direction, tangent / np.linalg.norm(tangent))
    line = place + _middles(rows)[:, None] * height_mm * height
    angle = _middles(columns) * arc
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(columns)
    turns = np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1]]).transpose(2, 0, 1)
    points = np.einsum("cij,rj->rci", turns, line).reshape(-1, 3)
    return points, np.tile(turns @ direction, (rows, 1))


def _middles(count: int) -> np.ndarray:
    """Middles of ``count`` equal parts of [-0.5, 0.5]."""
    return (np.arange(count) + 0.5) / count - 0.5


def _longest_mm(light: Light) -> float:
    """Length that no cell may exceed [mm]."""
    return max(-light.position_mm[2] / 4, _LEAST_CELL_MM)


def _counts(size_mm: tuple[float, float], samples: int, longest_mm: float) -> tuple[int, int]:
    """Columns and rows of cells: at most ``samples`` in all that are nearest to squares, more where
    they would be longer than ``longest_mm``."""
    width, height = size_mm
    if width == 0 and height == 0:
        return 1, 1
    if width == 0 or height == 0:
        found = (samples, 1) if width > 0 else (1, samples)
    else:
        options = [(c, samples // c) for c in range(1, samples + 1)]
        found = min(options, key=lambda cr: abs(math.log(width / cr[0] / (height / cr[1]))))
    columns, rows = (
        max(count, math.ceil(length / longest_mm))
        for count, length in zip(found, size_mm, strict=True)
    )
    return columns, rows
