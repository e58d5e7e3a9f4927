# SPDX-License-Identifier: Apache-2.0
"""A GelSight Mini that tools are pressed into by the law of a bonded layer, and its images."""

from __future__ import annotations

import cv2
import numpy as np

import taccel_lab as tl
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, press_layer
from taccel_lab.reading.reading import Reading
from taccel_lab.signals.height_image import levels_of_heights
from taccel_lab.signals.rest_surface import rest_surface

DOUBLE = 2
"""Pixels along a step of the grid that tools are pressed on."""
NOISE_LEVELS = 0.5


class PressedMini:
    """A GelSight Mini with its own starter profile, untouched until it is pressed."""

    def __init__(self) -> None:
        self.sensor = tl.load_sensor("gelsight_mini")
        self.grid, material = self.sensor.grid(), self.sensor.material
        self.layer = BondedLayer(self.sensor.gel.thickness_mm, material.poisson_ratio)
        self.pa = material.young_modulus_pa / (2 * (1 - material.poisson_ratio**2))
        self.rest_m = rest_surface(self.sensor.mesh, self.grid).height_m
        self.still = np.zeros(self.rest_m.shape)
        self.reader = tl.Reader(self.sensor, background=self.seen(self.still))

    def levels(self, rise_mm: np.ndarray) -> np.ndarray:
        """What a face shows, RGB levels, float."""
        return levels_of_heights(self.sensor, self.rest_m + 1e-3 * rise_mm)

    def seen(self, rise_mm: np.ndarray, seed: int = 5) -> np.ndarray:
        """Image of a face, with a camera's noise."""
        return self.noisy(self.levels(rise_mm), seed)

    def noisy(self, levels: np.ndarray, seed: int = 5, noise: float = NOISE_LEVELS) -> np.ndarray:
        """Levels as a camera gives them."""
        levels = levels + np.random.default_rng(seed).normal(0, noise, levels.shape)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def pressed(self, gap) -> tuple[np.ndarray, float, float]:
        """Rise [mm] under a tool whose underside lies at ``gap(x, y)`` [mm], negative below the
        face at rest, its force [N] and its area [mm2] in the view."""
        steps = DOUBLE * self.grid.mm_per_px_x, DOUBLE * self.grid.mm_per_px_y
        rows, columns = self.grid.height_px // DOUBLE, self.grid.width_px // DOUBLE
        beyond = int(4 * self.layer.thickness_mm / steps[0])
        x = (np.arange(columns + 2 * beyond) + 0.5 - beyond - columns / 2) * steps[0]
        y = (np.arange(rows + 2 * beyond) + 0.5 - beyond - rows / 2) * steps[1]
        tool = gap(*np.meshgrid(x, y))
        depth = -float(tool.min())
        found = press_layer(tool + depth, depth, steps, self.layer)
        view = slice(beyond, beyond + rows), slice(beyond, beyond + columns)
        rise_mm = cv2.resize(found.rise_mm[view], self.rest_m.shape[::-1])
        area = steps[0] * steps[1]
        force_n = self.pa * 1e-6 * area * float(found.pressure[view].sum())
        return rise_mm, force_n, area * float(found.contact[view].sum())

    def press(self, gap) -> tuple[Reading, float, float]:
        """Reading of such a press, and its true force and area."""
        rise_mm, force_n, area_mm2 = self.pressed(gap)
        return self.reader(self.seen(rise_mm)), force_n, area_mm2


def flat(is_tool, depth_mm: float):
    """Gap of a flat tool that is where ``is_tool(x, y)`` [mm] says."""
    return lambda x, y: np.where(is_tool(x, y), -depth_mm, FAR_MM - depth_mm)


def ball(radius_mm: float, depth_mm: float, x_mm: float = 0.0, y_mm: float = 0.0):
    """Gap of a ball."""
    return lambda x, y: np.hypot(x - x_mm, y - y_mm) ** 2 / (2 * radius_mm) - depth_mm


def inside(value: float, interval: tuple[float, float] | None) -> bool:
    """Whether an interval holds a value."""
    assert interval is not None
    return interval[0] <= value <= interval[1]
