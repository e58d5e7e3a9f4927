# SPDX-License-Identifier: Apache-2.0
"""How large the contact of a tool is, at a step of presses."""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.presses import Indenter, PressEnv
from taccel_lab.presses.press_outcome import contact_radii_m
from taccel_lab.scene import Ball

_PX = 161
_MARGIN = 1.3
_MEASURED = ("sphere", "cylinder", "box", "roller")
"""Tools with one contact without holes."""


def measured_contact_mm(
    env: PressEnv, indenter: Indenter, gel_from_press: np.ndarray
) -> np.ndarray | None:
    """Radius of the disc of the contact's area in each environment [mm], [env_count]; None of tools
    without one.

    Of the fine surface (``FineSurface``), seen along the presses, whose frames are
    ``gel_from_press``, [env_count, 7].
    """
    if indenter.name.partition(":")[0] not in _MEASURED:
        return None
    shape = indenter.shape
    if isinstance(shape, Ball):
        reach_m = shape.radius_m
    else:
        reach_m = float(np.abs(shape.vertices_m[:, :2]).max())
    grid = PixelGrid(_PX, _PX, *2 * [2 * _MARGIN * reach_m * 1e3 / (_PX - 1)])
    return 1e3 * contact_radii_m(env, indenter, grid, gel_from_press)
