# SPDX-License-Identifier: Apache-2.0
"""Ball presses by a 3D printer whose head holds the ball: G-code for Marlin, and their table.

As py3DCal probes (Kotanu et al.; Ender 3, ball over the gel, from a touch that a person finds), but
with slow feeds near the gel, bounds that are checked before anything is written, and a table by
which the captures get their depths and places (``PRESSES_TABLE``).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.guide import DOME_MM, capture_plan
from taccel_lab.calibration.capture.sensor_facts import GENERIC, sensor_facts
from taccel_lab.errors import InputError
from taccel_lab.files.table_file import read_table
from taccel_lab.sensors import sensor_family

PRINTERS = {"ender3": (220.0, 220.0, 250.0), "prusa_mk4": (250.0, 210.0, 220.0)}
"""Build volumes along X, Y and Z [mm], of the makers' data sheets."""
PRESSES_TABLE, GCODE = "printer_presses.csv", "presses.gcode"
COLUMNS = ("image", "x_mm", "y_mm", "depth_mm", "radius_mm")
"""Columns of the table: file name, place in the printer's axes from the middle of the gel, travel
past first touch, radius of the ball."""
CLEAR_MM = 5.0
"""Distance from the gel to the ball while the head travels."""
SLOW_MM = 1.0
"""Distance from the gel at which the slow feed begins: more than a touch found by eye is off."""
TRAVEL, LOWER, SLOW = 1200, 300, 30
"""Feeds in the plane, down to ``SLOW_MM``, and into the gel [mm/min]."""
HOLD_S, REST_S = 4.0, 3.0
"""How long a press stays, and the gel rests after it [s]: ``capture record`` takes a picture when a
contact has stood still for 0.4 s, and looks for a mark for 1.5 s."""
LEVELS = (0.4, 0.7, 1.0)
"""Depths at each place, as parts of the deepest."""
_SIZE = re.compile(r"(\d{2,4}(?:\.\d+)?)x(\d{2,4}(?:\.\d+)?)x(\d{2,4}(?:\.\d+)?)")


@dataclass(frozen=True)
class PrinterPress:
    """One press."""

    image: str
    """File name that its picture gets."""
    x_mm: float
    """Place in the printer's axes, from the middle of the gel."""
    y_mm: float
    depth_mm: float
    """Travel past first touch there."""
    touch_mm: float
    """How far lower the first touch is there than in the middle of the gel."""


@dataclass(frozen=True)
class PrinterPlan:
    """Presses, and where the printer makes them."""

    sensor: str
    bed_mm: tuple[float, float, float]
    """The printer's build volume."""
    touch_mm: tuple[float, float, float]
    """Where the printer is when the ball just touches the middle of the gel."""
    ball_radius_mm: float
    presses: tuple[PrinterPress, ...]

    @property
    def minutes(self) -> float:
        """How long the printer takes, without acceleration."""
        slow = sum(2 * (SLOW_MM + press.depth_mm) / SLOW for press in self.presses)
        fast = 2 * (CLEAR_MM - SLOW_MM) / LOWER * len(self.presses)
        places = np.array([(press.x_mm, press.y_mm) for press in self.presses])
        travel = float(np.hypot(*np.diff(places, axis=0).T).sum()) / TRAVEL
        return slow + fast + travel + (HOLD_S + REST_S) / 60 * len(self.presses)

    def table(self) -> str:
        """The presses as CSV, ``COLUMNS``."""
        rows = [
            f"{p.image},{p.x_mm:.3f},{p.y_mm:.3f},{p.depth_mm:.3f},{self.ball_radius_mm:g}"
            for p in self.presses
        ]
        return "\n".join([",".join(COLUMNS), *rows]) + "\n"

    def gcode(self) -> str:
        """The program, for Marlin."""
        x, y, z = self.touch_mm
        clear = z + CLEAR_MM
        deepest = max(press.depth_mm for press in self.presses)
        lines = [
            f"; {len(self.presses)} presses of a ball of {self.ball_radius_mm:g} mm radius into "
            f"{self.sensor}, up to {deepest:g} mm deep: {math.ceil(self.minutes)} minutes, Marlin",
            "; 1. Home all axes with the ball and the sensor off. This program never homes: G28",
            ";    would drive the ball into the gel.",
            "; 2. Fix the sensor on the bed, gel up, columns of its image along X. Mount the ball.",
            "; 3. Jog until the ball just touches the middle of the gel. M114 has to say",
            f";    X{x:g} Y{y:g} Z{z:g}; otherwise write this file again with what it says.",
            "; 4. Jog up. Start taccel-lab capture record, then this program.",
            "M104 S0 ; nozzle off",
            "M140 S0 ; bed off",
            "M107 ; fan off",
            "M211 S1 ; keep to the build volume",
            "G21 ; millimetres",
            "G90 ; absolute",
            f"G1 Z{clear:.3f} F{LOWER}",
            "M0 Is the untouched gel recorded? Then go on",
        ]
        for number, press in enumerate(self.presses, 1):
            top = z - press.touch_mm
            lines += [
                f"M117 {number} of {len(self.presses)}",
                f"G1 X{x + press.x_mm:.3f} Y{y + press.y_mm:.3f} F{TRAVEL} ; {press.image}",
                f"G1 Z{top + SLOW_MM:.3f} F{LOWER}",
                f"G1 Z{top - press.depth_mm:.3f} F{SLOW}",
                f"G4 S{HOLD_S:g} ; its picture is taken",
                f"G1 Z{top + SLOW_MM:.3f} F{SLOW}",
                f"G1 Z{clear:.3f} F{LOWER}",
                f"G4 S{REST_S:g}",
            ]
        return "\n".join([*lines, "M117 All presses are made"]) + "\n"


def parse_printer(text: str) -> tuple[float, float, float]:
    """Build volume [mm] of one of ``PRINTERS``, or of ``WIDTHxDEPTHxHEIGHT``; InputError for
    others."""
    if text in PRINTERS:
        return PRINTERS[text]
    found = _SIZE.fullmatch(text)
    if found is None:
        raise InputError(
            f"--printer is {text!r}; {', '.join(PRINTERS)} or the build volume in millimetres, "
            "such as 220x220x250, is allowed"
        )
    return float(found[1]), float(found[2]), float(found[3])


def printer_plan(
    sensor: str, bed_mm: tuple[float, float, float], touch_mm: tuple[float, float, float]
) -> PrinterPlan:
    """The ball presses of ``capture_plan`` for a printer.

    Args:
        sensor: Of the catalogue.
        bed_mm: The printer's build volume, from 0 along each axis.
        touch_mm: Where the printer is when the ball just touches the middle of the gel.

    Raises:
        InputError: No such sensor, a dome, or a press that the printer does not reach.
    """
    plan = capture_plan(sensor)
    facts = sensor_facts(plan.sensor)
    if facts is not None and facts.drop_mm > DOME_MM:
        raise InputError(
            f"{plan.sensor} is a dome, and a printer presses straight down: press its sides by "
            "hand along their normals"
        )
    parameters = sensor_family(plan.sensor).parameters()
    pad, grid = parameters.pad(), parameters.grid()
    low, high = pad.bounds_mm()
    if plan.sensor in GENERIC:  # Stands for any gel: its design says nothing of this one.
        low, high = low / 2, high / 2
    radius, depth = plan.ball_radius_mm, plan.depth_mm
    rim = math.sqrt(depth * (2 * radius - depth))
    sides = grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y
    half = np.array([min(side, high[k] - low[k]) / 2 - rim for k, side in enumerate(sides)])
    if not (half > rim).all():
        raise InputError(
            f"a ball of {radius:g} mm radius leaves no room for places on {plan.sensor}'s gel"
        )
    few = plan.press_count < 36
    levels = (LEVELS[0], LEVELS[-1]) if few else LEVELS
    columns, rows = (1, 1) if few else (4, 3)
    places = _grid(half, columns, rows) if not few else [(0.0, 0.0), *_grid(half, 2, 2)]
    spots = [(place, level * depth) for place in places for level in levels]
    spots += [(place, depth) for place in _grid(half / 2, 2, 2)][: plan.press_count - len(spots)]
    presses = []
    for number, ((x, y), deep) in enumerate(spots):
        drop = _later_touch_mm(pad, (x, y), radius)
        presses.append(PrinterPress(f"press_{number:03d}.png", x, y, round(deep, 3), drop))
    found = PrinterPlan(plan.sensor, bed_mm, touch_mm, radius, tuple(presses))
    _require_reach(found)
    return found


def _grid(half_mm: np.ndarray, columns: int, rows: int) -> list[tuple[float, float]]:
    """Places over a rectangle about the middle, row by row, to and fro."""
    found = []
    for j in range(rows):
        line = [
            (half_mm[0] * (2 * i / (columns - 1) - 1), half_mm[1] * (2 * j / (rows - 1) - 1))
            for i in range(columns)
        ]
        found += line if j % 2 == 0 else line[::-1]
    return [(round(float(x), 3), round(float(y), 3)) for x, y in found]


def _later_touch_mm(pad: Any, place_mm: tuple[float, float], radius_mm: float) -> float:
    """How much lower a ball over a place first touches a curved face than over its middle."""
    steps = np.linspace(-radius_mm, radius_mm, 41)
    away = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    away = away[np.hypot(*away.T) < radius_mm]
    ball = np.sqrt(radius_mm**2 - (away**2).sum(axis=1)) - radius_mm

    def height(place: Sequence[float]) -> float:
        # The underside of the ball, resting on what is highest below it.
        return float(np.nanmax(pad.top_mm(np.asarray(place) + away) + ball))

    return height((0.0, 0.0)) - height(place_mm)


def _require_reach(plan: PrinterPlan) -> None:
    x, y, z = plan.touch_mm
    for axis, at, offsets, size in (
        ("X", x, [press.x_mm for press in plan.presses], plan.bed_mm[0]),
        ("Y", y, [press.y_mm for press in plan.presses], plan.bed_mm[1]),
        ("Z", z, [CLEAR_MM, *(-p.touch_mm - p.depth_mm for p in plan.presses)], plan.bed_mm[2]),
    ):
        low, high = min(offsets), max(offsets)
        if not (math.isfinite(at) and 0 <= at + low and at + high <= size):
            raise InputError(
                f"--touch has {axis} = {at:g} mm; {-low:.1f} to {size - high:.1f} mm is allowed, "
                f"so that all presses lie in the printer's {size:g} mm"
            )


def read_press_table(path: Path) -> list[dict[str, Any]]:
    """``depth_mm`` and ``stage_mm`` of each press, in the order in which they were made.

    Raises:
        InputError: No such table, or a value that is none of a press.
    """
    table = read_table(path)
    x, y, depth = (table.require_column(name) for name in COLUMNS[1:4])
    found = []
    for row in table.rows():
        deep = row.number(depth)
        if not 0 < deep <= 50:
            raise row.error(f"depth_mm is {deep:g}; 0 to 50 mm is allowed")
        found.append({"depth_mm": deep, "stage_mm": [row.number(x), row.number(y)]})
    if not found:
        raise InputError(f"{path} has no presses")
    return found
