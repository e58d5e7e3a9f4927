# SPDX-License-Identifier: Apache-2.0
"""How large the contact of a tool is, at each step of a press."""

from __future__ import annotations

import numpy as np

from taccel_lab.envs import parse_indenter
from taccel_lab.geometry import PixelGrid
from taccel_lab.model.embedding import rotate
from taccel_lab.scene import Ball
from taccel_lab.signals import HeightFieldSurface, SignalFusedSurface, SphereSurface
from taccel_lab.studies.press_record import PressRecord

_PX = 161
_MARGIN = 1.3
_MEASURED = ("sphere", "cylinder", "box", "roller")
"""Tools with one contact without holes."""


def measured_contact_mm(record: PressRecord) -> np.ndarray | None:
    """Radius of the disc of the contact's area at each step [mm]; None of tools without one.

    Found on the surface fused from gel and tool (``SignalFusedSurface``), seen along the press.
    """
    count = len(record.depth_mm)
    if record.indenter.partition(":")[0] not in _MEASURED or not count:
        return None
    shape = parse_indenter(record.indenter).shape
    poses = record.indenter_poses
    points = np.stack([record.in_press(record.positions_m(step)) for step in range(count)])
    if isinstance(shape, Ball):
        grid = _grid(shape.radius_m)
        centers = np.stack([record.in_press(pose[:3]) for pose in poses])
        surface = SphereSurface(centers, shape.radius_m, grid)
    else:
        grid = _grid(float(np.abs(shape.vertices_m[:, :2]).max()))
        vertices = np.stack([
            record.in_press(pose[:3] + rotate(pose[3:], shape.vertices_m)) for pose in poses
        ])  # fmt: skip
        surface = HeightFieldSurface.from_mesh(vertices, shape.faces, grid)
    fused = SignalFusedSurface(record.mesh, grid, device=record.device)
    fused.update(points, surface, record.pressures_pa)
    return fused.contact_radius_m * 1e3


def _grid(reach_m: float) -> PixelGrid:
    return PixelGrid(_PX, _PX, *2 * [2 * _MARGIN * reach_m * 1e3 / (_PX - 1)])
