# SPDX-License-Identifier: Apache-2.0
"""The mesh of a sensor's gel for one press: fine around the contact, one connectivity for all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh
from sensors.registry import sensor_family
from taccel_lab.envs.physics import PressMeshOptions
from taccel_lab.geometry import TetMesh


def press_mesh(
    family: str,
    parameters: Mapping[str, Any],
    at_mm: tuple[float, float],
    contact_radius_mm: float,
    options: PressMeshOptions | None = None,
) -> TetMesh:
    """Gel pad of a catalogue sensor, graded around the contact at gel xy ``at_mm``.

    All meshes of the same options share tets, faces and regions bitwise, whatever the place.
    Raises InputError for an unknown family or a place too close to the pad's edge.
    """
    options = options or PressMeshOptions()
    found = sensor_family(family)
    focus = FocusOptions(
        at_mm=at_mm,
        radius_mm=options.fine_radii * contact_radius_mm,
        size_mm=contact_radius_mm / options.elements_per_radius,
        core=options.core,
        rings=options.rings,
        layers=options.layers,
    )
    return focused_gel_mesh(found.pad(found.parameters(parameters)), focus)
