# SPDX-License-Identifier: Apache-2.0
"""Whether the pad lies under what an image shows: one test for the check and for calibrations.

Beside the pad there is no gel that a press could move, and near its edge a pressed pad may leave
pixels that it covered: meshes cut rounded corners short (by 0.11 mm on a GelSight Mini), and gel
gives way. Such pixels are used by nothing. An image that shows clearly more than the pad is
rejected: its scale is wrong, or what lies beside the gel has to be masked.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.shared_remarks import PAD_EDGE, SCALE_PAST_PAD
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.sensors.registry import profile_parameters

EDGE_MM = 0.5
"""Gel along the pad's edge that is not used: no camera of the catalogue shows any of it."""
LATTICE = 81
"""Pixels along a side whose distance is computed."""
OVERHANG_SHARE = 0.025
"""How far an image may reach past the pad's edge, as a part of the pad's longer side: stated scales
are rounded."""


def inside_mm(parameters: FamilyParameters, grid: PixelGrid) -> np.ndarray:
    """Distance of each pixel in plan to the edge of the pad's contact face [mm], positive over the
    pad, shape [height_px, width_px]; linear between pixels of a lattice."""
    u, v, known = _lattice(parameters, grid)
    rows = np.array([np.interp(np.arange(grid.width_px), u, row) for row in known])
    return np.array([np.interp(np.arange(grid.height_px), v, column) for column in rows.T]).T


def _lattice(
    parameters: FamilyParameters, grid: PixelGrid
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns, rows and distances [row, column] of pixels spread over the image."""
    u, v = (
        np.unique(np.linspace(0, count - 1, min(count, LATTICE)).round())
        for count in (grid.width_px, grid.height_px)
    )
    u, v = u.astype(int), v.astype(int)
    x, y = np.meshgrid(grid.x_mm()[u], grid.y_mm()[v])
    return u, v, parameters.pad().inside_distance_mm(np.stack([x, y], axis=-1))


def _is_far_inside(parameters: FamilyParameters, grid: PixelGrid) -> bool:
    """Whether nothing of the image is near the edge, as images usually are."""
    return bool(_lattice(parameters, grid)[2].min() >= EDGE_MM)


def looks_past_pad(parameters: FamilyParameters) -> bool:
    """Whether the sensor's own camera sees more than the pad in plan, as lenses in domes do."""
    return bool(_lattice(parameters, parameters.grid())[2].min() < 0)


def view_remarks(
    parameters: FamilyParameters, grid: PixelGrid, mask: np.ndarray | None = None
) -> list[Remark]:
    """What an image shows beside the pad, as far as it is used (``mask``): an error where that is
    too much, a warning where it is left out."""
    if _is_far_inside(parameters, grid):
        return []
    used = np.ones((grid.height_px, grid.width_px), dtype=bool) if mask is None else mask
    inside = inside_mm(parameters, grid)
    least = float(inside[used].min())
    if least >= EDGE_MM:
        return []
    size_x, size_y = np.ptp(parameters.pad().bounds_mm()[:, :2], axis=0)
    figures = {
        "mm_per_px_x": grid.mm_per_px_x,
        "mm_per_px_y": grid.mm_per_px_y,
        "width": grid.width_px * grid.mm_per_px_x,
        "height": grid.height_px * grid.mm_per_px_y,
        "pad_x": size_x,
        "pad_y": size_y,
    }
    if looks_past_pad(parameters):
        # Normals are read wherever its camera sees; a layer stands for the pad in plan alone.
        blocks = ("color",)
        return [SCALE_PAST_PAD(**figures, blocks=blocks)] if least < 0 else []
    if least < -OVERHANG_SHARE * max(size_x, size_y):
        return [SCALE_PAST_PAD(**figures)]
    share = float((inside[used] < EDGE_MM).mean())
    return [PAD_EDGE(**figures, share=share, edge=EDGE_MM, grave=least < 0)]


def pixels_on_pad(profile: SensorProfile, grid: PixelGrid, mask: np.ndarray) -> np.ndarray:
    """The usable pixels ``mask`` that the pad of ``profile`` covers, pressed too; bool, of its
    shape. A camera that sees past its pad by design keeps all."""
    parameters = profile_parameters(profile)
    if _is_far_inside(parameters, grid) or looks_past_pad(parameters):
        return mask
    return mask & (inside_mm(parameters, grid) >= EDGE_MM)


def require_view_on_pad(
    profile: SensorProfile, grid: PixelGrid, mask: np.ndarray | None, source: str, block: str
) -> None:
    """InputError where ``block`` cannot use an image of ``grid`` since it shows too much beside the
    pad."""
    for remark in view_remarks(profile_parameters(profile), grid, mask):
        if remark.severity == Severity.ERROR and block in remark.blocks:
            raise InputError(f"{source}: {remark.message}")
