# SPDX-License-Identifier: Apache-2.0
"""Reports and pictures: one self-contained HTML page, a JSON and PNG files."""

from taccel_lab.report.figures import (
    draw_contact_forces,
    draw_force_depth,
    draw_height_map,
    draw_image,
    draw_markers,
    draw_normals,
)
from taccel_lab.report.style import save_drawing, save_figure

__all__ = [
    "draw_contact_forces",
    "draw_force_depth",
    "draw_height_map",
    "draw_image",
    "draw_markers",
    "draw_normals",
    "save_drawing",
    "save_figure",
]
