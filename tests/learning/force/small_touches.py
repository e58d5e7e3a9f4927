# SPDX-License-Identifier: Apache-2.0
"""A data set of touches without a simulation: dents drawn by a formula, with their forces.

Forces are those of a ball on a half-space with a friction that grows along the face, times the
modulus of the touch; the picture shows the dent's slopes. Written as data sets are, for their
readers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.datasets.channels import channels_of
from taccel_lab.datasets.folder import DatasetFolder
from taccel_lab.datasets.motion import TouchRecord
from taccel_lab.datasets.part import part_data, write_part
from taccel_lab.datasets.plan import DatasetPlan
from tests.support.small_data_sets import plan

TOOLS = {"sphere:2": 2.0, "sphere:3": 3.0, "sphere:4": 4.0, "sphere:5": 5.0, "sphere:6": 6.0}
TEST = "sphere:4"
ROWS, COLUMNS = 3, 4


def planned(
    profile: Path,
    *,
    episodes: int = 120,
    held_out: bool = True,
    depth_mm: tuple[float, float] = (0.2, 0.8),
    **output: Any,
) -> DatasetPlan:
    """Touches of five balls by four units; a ball and a unit are for tests, where wanted."""
    channels = output.pop("channels", ["rgb", "patch_forces_n", "markers_px"])
    return plan(
        profile,
        dataset={"episodes": episodes, "seed": 3, "view": 0.5},
        sensors=[{"profile": str(profile), "units": 4, "test_units": 1 if held_out else 0}],
        objects=[
            {"tool": tool, "split": "test" if tool == TEST and held_out else "train"}
            for tool in TOOLS
        ],
        motions=[
            {"kind": "shear", "depth_mm": list(depth_mm), "shear_mm": [0.2, 0.5], "step_mm": 0.3}
        ],
        randomise={"young_modulus_factor": [0.7, 1.4]},
        output={"channels": channels, "patches": [COLUMNS, ROWS], "episodes_per_part": 64},
    )


def write_touches(planned: DatasetPlan, root: Path) -> Path:
    folder = DatasetFolder(root)
    folder.begin(planned, "made up")
    markers_mm = planned.sensors[0].marker_places_mm()
    for part in planned.parts:
        records = [drawn(planned, number, markers_mm) for number in part.episodes]
        write_part(folder.part(part), part_data(planned, part, records), planned)
    folder.write_index()
    return root


def drawn(planned: DatasetPlan, number: int, markers_mm: np.ndarray) -> TouchRecord:
    episode, sensor = planned.episodes[number], planned.sensors[0]
    grid = sensor.grid
    commands = np.concatenate([np.zeros((1, 6)), episode.path.commands()])
    radius = TOOLS[planned.spec.objects[episode.object].label]
    count = len(commands)
    at = np.array([episode.placing.x_mm, episode.placing.y_mm])
    depth, shear = commands[:, 0], commands[:, 1:3]
    force_z = 0.8 * episode.young_modulus_factor * np.sqrt(radius) * depth**1.5
    force = np.column_stack([0.8 * force_z[:, None] * shear, force_z])
    arm = np.array([*at, 0.0])
    uv = np.stack(np.meshgrid(np.arange(grid.width_px), np.arange(grid.height_px)), axis=-1)
    xy = grid.gel_from_pixel(uv.astype(float))
    rgb = np.empty((count, grid.height_px, grid.width_px, 3))
    assert sensor.color is not None
    for k in range(count):
        away = xy - at - 0.5 * shear[k]
        inside = np.exp(-0.5 * (away**2).sum(-1) / (0.3 + radius * depth[k]))
        slope = -away / radius * inside[..., None] * min(1.0, depth[k] * 10)
        change = [slope[..., 0], slope[..., 1], -depth[k] * inside]
        lateral = 0.3 * (away @ shear[k])[..., None] * inside[..., None]
        rgb[k] = sensor.color[1] + 70 * np.stack(change, axis=-1) + 40 * lateral
    patches = np.zeros((count, ROWS, COLUMNS, 3))
    edge = np.array([grid.width_px, grid.height_px]) / [COLUMNS, ROWS]
    column, row = (grid.pixel_from_gel(at[None])[0] // edge).astype(int)
    patches[:, row, column] = force
    values: dict[str, np.ndarray] = {
        "episode": np.full(count, number),
        "step": np.arange(count),
        "command": commands,
        "wrench": np.column_stack([force, 1e-3 * np.cross(arm, force)]),
        "contact_area_mm2": np.pi * radius * depth,
        "patch_forces_n": patches,
        "rgb": np.rint(rgb.clip(0, 255)),
        "markers_px": _markers(planned, markers_mm, commands, at),
        "status": np.ones(count),
        "force_error_n": 0.02 * force_z,
    }
    channels = channels_of(planned.spec.output.channels)
    shapes = {"tool_pose": (count, 7), "press_force_n": (count, 3), "contact_center_mm": (count, 2)}
    rows = {
        c.name: values.get(c.name, np.zeros(shapes.get(c.name, count))).astype(c.dtype)
        for c in channels
    }
    face = np.zeros((3, 3)), np.array([[0, 1, 2]], dtype=np.int32)
    return TouchRecord(number, rows, count - 1, "", np.array([0, 0, 0, 0, 0, 0, 1.0]), *face)


def _markers(
    planned: DatasetPlan, rest: np.ndarray, commands: np.ndarray, at: np.ndarray
) -> np.ndarray:
    sensor = planned.sensors[0]
    near = np.exp(-0.5 * ((rest - at) ** 2).sum(axis=1) / 4.0)
    moved = rest[None] + near[None, :, None] * commands[:, None, 1:3]
    return np.stack([sensor.grid.pixel_from_gel(one) for one in moved])
