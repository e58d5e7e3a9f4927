# SPDX-License-Identifier: Apache-2.0
"""The recorded path of a tool over the frames of a video, and a press that follows it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.material.gel_presses import Stop
from taccel_lab.errors import InputError

FRAMES = 8
"""Frames of a video that are fitted, evenly along the tool's path."""
LARGEST_STEP_MM = 0.2
LARGEST_STEP_DEG = 2.0


@dataclass(frozen=True)
class ToolPath:
    """Where the tool is in each frame."""

    depth_mm: np.ndarray
    """Past first touch, 0 above the gel, shape [frame]."""
    shift_mm: np.ndarray
    """From the place of first touch, shape [frame, 2]."""
    angle_deg: np.ndarray
    """Turn about +z, shape [frame]."""
    place_mm: tuple[float, float] = (0.0, 0.0)
    """Gel xy of first touch [mm]."""

    @classmethod
    def of_poses(cls, poses: dict[str, np.ndarray], source: str) -> ToolPath:
        """From the columns of a path file: z_mm is 0 at first touch and negative in the gel; x_mm
        and y_mm are gel coordinates; missing columns are 0."""
        if "z_mm" not in poses:
            raise InputError(f"{source}: the path needs z_mm (0 at first touch, negative below)")
        count = len(poses["z_mm"])
        zero = np.zeros(count)
        depth = np.maximum(-poses["z_mm"], 0.0)
        if depth.max() <= 0:
            raise InputError(
                f"{source}: z_mm never falls below 0, so the tool never touches; z points out of "
                "the gel and is 0 at first touch"
            )
        shift = np.stack([poses.get("x_mm", zero), poses.get("y_mm", zero)], axis=1)
        place = shift[int(np.argmax(depth > 0))]
        angle = poses.get("angle_deg", zero)
        return cls(depth, shift - place, angle - angle[0], (float(place[0]), float(place[1])))

    def chosen(self, count: int = FRAMES) -> np.ndarray:
        """Frames evenly along the path up to its end; those before the first touch are left out."""
        touching = np.flatnonzero(self.depth_mm > 0)
        way = np.zeros(len(self.depth_mm))
        way[1:] = np.abs(np.diff(self.depth_mm))
        way[1:] += np.linalg.norm(np.diff(self.shift_mm, axis=0), axis=1)
        way[1:] += np.abs(np.radians(np.diff(self.angle_deg)))
        way = np.cumsum(way)
        goals = np.linspace(way[touching[0]], way[touching[-1]], count + 1)[1:]
        return np.unique([touching[np.argmin(np.abs(way[touching] - goal))] for goal in goals])


def path_stops(way: np.ndarray) -> list[Stop]:
    """Stops on a path of rows depth [mm], shift x and y [mm], angle [deg]; the rows are read."""
    stops, before = [], np.zeros(4)
    for goal in way:
        largest = max(
            np.abs(goal - before)[:3].max() / LARGEST_STEP_MM,
            abs(goal[3] - before[3]) / LARGEST_STEP_DEG,
        )
        count = max(1, math.ceil(largest - 1e-9))
        for i in range(1, count + 1):
            depth, x, y, angle = (before + (goal - before) * (i / count)).tolist()
            stops.append(Stop(depth, (x, y), angle, read=i == count))
        before = goal
    return stops
