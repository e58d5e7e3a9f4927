# SPDX-License-Identifier: Apache-2.0
"""Where the object of an episode goes, step by step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

COMMAND = ("depth_mm", "shear_x_mm", "shear_y_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg")
"""Columns of what is asked of a step, in the object's frame at the start: depth past first touch,
motion along the face, rotation vector. A roll moves the object on besides (``rolled_mm``)."""


@dataclass(frozen=True)
class TouchMotion:
    """Down to a depth, then sideways, about the axis or rolling, in equal steps."""

    kind: str
    depth_mm: float
    shear_mm: float = 0.0
    direction_deg: float = 0.0
    """Of shear and roll, from the object's x towards its y."""
    twist_deg: float = 0.0
    roll_deg: float = 0.0
    step_mm: float = 0.2
    step_deg: float = 2.0

    @property
    def down_count(self) -> int:
        """Steps down."""
        return max(1, math.ceil(self.depth_mm / self.step_mm - 1e-9))

    @property
    def step_count(self) -> int:
        side = (
            self.shear_mm / self.step_mm,
            abs(self.twist_deg) / self.step_deg,
            abs(self.roll_deg) / self.step_deg,
        )
        return self.down_count + math.ceil(max(side) - 1e-9)

    def commands(self) -> np.ndarray:
        """What is asked of each step, columns ``COMMAND``, [step, 6]."""
        down = self.down_count
        count = self.step_count
        there = np.zeros((count, 6))
        there[:, 0] = self.depth_mm * np.minimum(np.arange(1, count + 1) / down, 1.0)
        side = np.arange(1, count - down + 1) / max(count - down, 1)
        direction_rad = math.radians(self.direction_deg)
        along, across = (
            np.array([math.cos(direction_rad), math.sin(direction_rad)]),
            np.array([-math.sin(direction_rad), math.cos(direction_rad)]),
        )
        there[down:, 1:3] = side[:, None] * self.shear_mm * along
        there[down:, 3:5] = side[:, None] * self.roll_deg * across
        there[down:, 5] = side * self.twist_deg
        return there


def rolled_mm(commands: np.ndarray, height_mm: np.ndarray) -> np.ndarray:
    """How far objects whose origins are ``height_mm`` [n] above the face have rolled on by their
    turns, [n, 2]: height times angle, as without sliding; ``commands`` is [n, 6]."""
    turn = np.radians(commands[:, 3:5])
    return height_mm[:, None] * np.column_stack([turn[:, 1], -turn[:, 0]])
