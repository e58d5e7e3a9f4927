# SPDX-License-Identifier: Apache-2.0
"""Contacts of tools that press hard in some places and weakly in others, in whole presses."""

from __future__ import annotations

import numpy as np

from taccel_lab.envs import PressPath, parse_indenter, simulate_press
from taccel_lab.geometry import PixelGrid
from taccel_lab.scene import Material
from taccel_lab.sensors.press_mesh import press_mesh

DEPTH_MM, AT_MM = 0.5, (1.2, -0.8)


def test_a_roller_touches_all_between_its_ends() -> None:
    """Its ends press many times as hard as its middle, which touches as well."""
    tool = parse_indenter("roller:1.5x4")
    mesh = press_mesh("gelsight_mini", {}, AT_MM, tool.contact(DEPTH_MM))
    grid = PixelGrid(198, 148, 0.0872, 0.0872)
    press = simulate_press(
        mesh, Material(1.5e5, 0.48), tool, AT_MM, PressPath(DEPTH_MM), grid,
        friction_coefficient=0.3,
    )  # fmt: skip
    rows, columns = np.nonzero(press.contact_mask)
    box = (np.ptp(rows) + 1) * (np.ptp(columns) + 1)
    assert len(rows) > 0.9 * box
    assert 4.0 <= (np.ptp(rows) + 1) * grid.mm_per_px_y < 4.2
    # The gel lies below the tool and no deeper than that went.
    sunk_mm = 1e3 * (press.height_m - press.rest_height_m)
    assert -1.01 * DEPTH_MM < sunk_mm.min() < -0.99 * DEPTH_MM
