# SPDX-License-Identifier: Apache-2.0
"""LEDs as a fixed set of points: area lights cut into equal cells, one point in the middle of each.

The set is the same for every pixel and frame, so that two renders of one design are equal and the
difference of two frames holds no noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.profile.optical_design import Light


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
    """Cut each area light into at most ``samples`` cells as near to squares as can be.

    A lobe cos^n of power P has the axial intensity P (n + 1) / (2 pi), so that its integral over
    the half-space is P.
    """
    positions, axes, intensities, lobes = [], [], [], []
    for light in lights:
        points = _cell_centres(light, samples)
        count = len(points)
        axial = np.array(light.rgb) * (light.lobe + 1) / (2 * math.pi) / count
        positions.append(points)
        axes.append(np.tile(light.direction, (count, 1)))
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


def _cell_centres(light: Light, samples: int) -> np.ndarray:
    columns, rows = _cells(light.size_mm, samples)
    width, height = emitter_axes(np.array(light.direction))
    across = ((np.arange(columns) + 0.5) / columns - 0.5) * light.size_mm[0]
    along = ((np.arange(rows) + 0.5) / rows - 0.5) * light.size_mm[1]
    grid = across[None, :, None] * width + along[:, None, None] * height
    return np.array(light.position_mm) + grid.reshape(-1, 3)


def _cells(size_mm: tuple[float, float], samples: int) -> tuple[int, int]:
    """Columns and rows, at most ``samples`` in all, whose cells are nearest to squares."""
    width, height = size_mm
    if width == 0 and height == 0:
        return 1, 1
    if width == 0 or height == 0:
        return (samples, 1) if width > 0 else (1, samples)
    options = [(c, samples // c) for c in range(1, samples + 1)]
    return min(options, key=lambda cr: abs(math.log(width / cr[0] / (height / cr[1]))))
