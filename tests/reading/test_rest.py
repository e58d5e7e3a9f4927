# SPDX-License-Identifier: Apache-2.0
"""Flat tools that leave no border at rest: half planes, corners and plates."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, press_layer
from taccel_lab.reading.reading import Reading
from taccel_lab.signals.rest_surface import rest_surface

DOUBLE = 2
"""Pixels along a step of the grid that tools are pressed on."""
TOOLS = {
    "half plane": lambda x, y: x > 0,
    "a third": lambda x, y: x > 3.0,
    "two thirds": lambda x, y: x > -4.0,
    "corner": lambda x, y: (x > 0) & (y > 0),
    "slanted half plane": lambda x, y: x + 0.5 * y > 1.0,
    "plate": lambda x, y: (np.abs(x) < 7.8) & (np.abs(y) < 5.9),
    "plate to the border": lambda x, y: (np.abs(x) < 9.6) & (np.abs(y) < 7.2),
    "ridge": lambda x, y: np.abs(x) < 1.5,
    "ridge at one side": lambda x, y: np.abs(x - 7.0) < 1.0,
}


class Bench:
    """A GelSight Mini that flat tools and balls are pressed into, by the law of a bonded layer."""

    def __init__(self) -> None:
        self.sensor = tl.load_sensor("gelsight_mini")
        self.grid, material = self.sensor.grid(), self.sensor.material
        self.layer = BondedLayer(self.sensor.gel.thickness_mm, material.poisson_ratio)
        self.pa = material.young_modulus_pa / (2 * (1 - material.poisson_ratio**2))
        self.rest_m = rest_surface(self.sensor.mesh, self.grid).height_m
        self.reader = tl.Reader(self.sensor, background=self.seen(np.zeros(self.rest_m.shape)))

    def seen(self, rise_mm: np.ndarray) -> np.ndarray:
        """Image of a face, with a camera's noise."""
        levels = self.sensor.render(self.rest_m + 1e-3 * rise_mm).astype(float)
        levels += np.random.default_rng(5).normal(0, 0.5, levels.shape)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def press(self, gap) -> tuple[Reading, float, float]:
        """Reading of a tool whose underside lies at ``gap(x, y)`` [mm], negative below the face at
        rest, and its true force [N] and area [mm2] in the view."""
        steps = DOUBLE * self.grid.mm_per_px_x, DOUBLE * self.grid.mm_per_px_y
        rows, columns = self.grid.height_px // DOUBLE, self.grid.width_px // DOUBLE
        beyond = int(4 * self.layer.thickness_mm / steps[0])
        x = (np.arange(columns + 2 * beyond) + 0.5 - beyond - columns / 2) * steps[0]
        y = (np.arange(rows + 2 * beyond) + 0.5 - beyond - rows / 2) * steps[1]
        tool = gap(*np.meshgrid(x, y))
        depth = -float(tool.min())
        pressed = press_layer(tool + depth, depth, steps, self.layer)
        view = slice(beyond, beyond + rows), slice(beyond, beyond + columns)
        rise_mm = cv2.resize(pressed.rise_mm[view], self.rest_m.shape[::-1])
        area = steps[0] * steps[1]
        force_n = self.pa * 1e-6 * area * float(pressed.pressure[view].sum())
        found = self.reader(self.seen(rise_mm))
        return found, force_n, area * float(pressed.contact[view].sum())


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


def inside(value: float, interval: tuple[float, float] | None) -> bool:
    assert interval is not None
    return interval[0] <= value <= interval[1]


@pytest.mark.parametrize(
    ("tool", "depth_mm"),
    [
        *((tool, 0.1) for tool in TOOLS),
        ("half plane", 0.05),
        ("half plane", 0.2),
        ("plate", 0.05),
        ("two thirds", 0.05),
    ],
)
def test_a_flat_tools_force_and_area_are_in_their_intervals(
    bench: Bench, tool: str, depth_mm: float
) -> None:
    """Whatever of the border it presses: before, a half plane 0.05 mm deep read 0 N (0 to 0.06)."""
    is_tool = TOOLS[tool]
    found, force_n, area_mm2 = bench.press(
        lambda x, y: np.where(is_tool(x, y), -depth_mm, FAR_MM - depth_mm)
    )
    assert found.touch.any
    assert inside(force_n, found.force_interval_n)
    assert inside(area_mm2, found.area_interval_mm2)
    assert inside(depth_mm, found.depth_interval_mm)
    assert force_n / 2.5 < found.force_n < 2.5 * force_n


def test_a_contact_that_hides_its_zero_says_so(bench: Bench) -> None:
    is_tool = TOOLS["plate to the border"]
    found, _, _ = bench.press(lambda x, y: np.where(is_tool(x, y), -0.1, FAR_MM - 0.1))
    assert any("nothing in view is at rest for certain" in note for note in found.notes)
    small, _, _ = bench.press(lambda x, y: np.where(np.hypot(x, y) < 2.0, -0.1, FAR_MM - 0.1))
    assert not any("at rest" in note for note in small.notes)


@pytest.mark.parametrize("radius_mm", [4.0, 50.0])
@pytest.mark.parametrize("at", [(0.0, 0.0), (7.0, 4.0)])
def test_a_ball_is_counted_from_the_whole_border(
    bench: Bench, radius_mm: float, at: tuple[float, float]
) -> None:
    """It leaves one flat part; its shallow contact may be wider than what surely touches."""
    found, force_n, area_mm2 = bench.press(
        lambda x, y: np.hypot(x - at[0], y - at[1]) ** 2 / (2 * radius_mm) - 0.1
    )
    assert inside(force_n, found.force_interval_n)
    assert inside(area_mm2, found.area_interval_mm2)


def test_an_untouched_gel_has_one_part(bench: Bench) -> None:
    found = bench.reader(bench.seen(np.zeros(bench.rest_m.shape)))
    assert not found.touch.any
    assert found.force_interval_n is not None and found.force_interval_n[1] < 0.2
