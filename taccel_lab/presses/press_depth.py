# SPDX-License-Identifier: Apache-2.0
"""How deep a press may go."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.presses.touch import gel_below_m

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile

MAX_DEPTH_FRACTION = 0.9
"""Deepest press as a part of the gel's thickness."""


def deepest_mm(mesh: TetMesh, at_mm: tuple[float, float]) -> float:
    """Deepest press of a gel at a place, but for what its mesh changes, which depends on the depth.

    ``mesh`` is in the gel frame, ``at_mm`` the gel xy.
    """
    contact = mesh.region_faces(Region.CONTACT)
    bonded = mesh.region_faces(Region.BOND, Region.WINDOW)
    thickness_m = gel_below_m(mesh.nodes_m, contact, bonded, 1e-3 * np.asarray(at_mm))
    return 0.99 * MAX_DEPTH_FRACTION * 1e3 * thickness_m


def check_depth(depth_mm: float, profile: SensorProfile) -> None:
    """Refuse a depth that no place of the pad allows, before a mesh is made for it."""
    thickness_mm = profile.gel.thickness_mm
    if not depth_mm <= MAX_DEPTH_FRACTION * thickness_mm:
        raise InputError(
            f"depth {depth_mm:g} mm goes past the gel, which is {thickness_mm:g} mm thick; at most "
            f"{MAX_DEPTH_FRACTION * thickness_mm:.3g} mm ({MAX_DEPTH_FRACTION:.0%}) is allowed"
        )
