# SPDX-License-Identifier: Apache-2.0
"""The mesh of a sensor's gel for one press: fine around the contact, one connectivity for all."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from taccel_lab.cad.mesh.contact_plan import ContactOutline
from taccel_lab.cad.mesh.convex_polygon import (
    centroid,
    clipped,
    thickened_hull,
    without_short_sides,
)
from taccel_lab.cad.mesh.focus import MIN_FOCUS_EDGE_MM, FocusOptions
from taccel_lab.cad.mesh.gel_mesh import focused_gel_mesh
from taccel_lab.cad.mesh.pad_plan_focused import rim_distances_mm, rim_rings
from taccel_lab.cad.mesh.template import FoldedMeshError, growth_factor
from taccel_lab.cad.parts.dome_pad import DomePad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.press_mesh_options import (
    DEFAULT_PRESS_MESH,
    OutlineMeshOptions,
    PressMeshOptions,
)
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.sensors.registry import sensor_family

LARGEST_LAYER_RATIO = 4.0
"""Thickest layer over the one above it."""
LARGEST_CONTACT_MM = 4.0
"""Radius of the largest disc that a mesh is graded for."""
LEAST_CONTACT_MM = 0.05
"""Least radius or half width that a mesh is graded for."""
LEAST_FILLED = 0.85
"""Part of its outline that a tool fills at least, or it counts as scattered."""
STEP_OF_TOP = 0.6
"""First step outside an outline over the thickness of the uppermost layer."""
BACK_SHARE, BACK_STEPS = 0.6, 5.0
"""A contact's least half width at the back, as a part of the thickness, and how much longer the
steps beside it are there."""
LEANS = (1.0, 1.5, 2.5)
"""How columns may lean between the two, in the order in which they are tried: straight ones are the
most exact, but below a narrow outline the first layers may fold."""
_ROOM_SIDES = 64
"""Lines that stand for the border of what a focus may cover of a pad."""


def press_mesh(
    family: str,
    parameters: Mapping[str, Any],
    at_mm: tuple[float, float],
    contact: float | ToolSection,
    options: PressMeshOptions = DEFAULT_PRESS_MESH,
) -> TetMesh:
    """Gel pad of a catalogue sensor, graded around the contact at gel xy ``at_mm``.

    ``contact`` is a ball's contact radius [mm] or the section of another tool, see
    ``Indenter.contact``. All meshes of the same options and kind of contact share tets, faces
    and regions bitwise, whatever the place. Raises InputError for an unknown family or a place too
    close to the pad's edge.
    """
    found = sensor_family(family)
    return pad_press_mesh(found.parameters(parameters).pad(), at_mm, contact, options)


def pad_press_mesh(
    pad: Pad,
    at_mm: tuple[float, float],
    contact: float | ToolSection,
    options: PressMeshOptions = DEFAULT_PRESS_MESH,
) -> TetMesh:
    """As ``press_mesh``, of a pad that need not be in the catalogue."""
    if not isinstance(contact, ToolSection):
        return focused_gel_mesh(pad, _disc_focus(at_mm, contact, pad.thickness_mm, options))
    outline = options.outline if contact.filled >= LEAST_FILLED else options.scattered
    focus = _outline_focus(at_mm, contact, pad, options, outline)
    # Columns of a dome stand on its sphere and have no lean.
    for lean in LEANS if isinstance(pad, HeightPad) else LEANS[:1]:
        try:
            return focused_gel_mesh(pad, replace(focus, lean=lean))
        except FoldedMeshError:
            continue
    # Some long contacts beside an edge leave no room for rings: even ones, of the same
    # connectivity. What that costs is in the estimate of the press's error.
    return focused_gel_mesh(pad, replace(focus, outlines=None))


def _disc_focus(
    at_mm: tuple[float, float], radius_mm: float, thickness_mm: float, options: PressMeshOptions
) -> FocusOptions:
    if not radius_mm > 0:
        raise InputError(f"a contact's radius must be above 0 mm, got {radius_mm:g}")
    radius = float(np.clip(radius_mm, LEAST_CONTACT_MM, LARGEST_CONTACT_MM))
    return FocusOptions(
        at_mm=at_mm,
        radius_mm=options.fine_radii * radius,
        size_mm=radius / options.elements_per_radius,
        core=options.core,
        rings=options.rings,
        layers=options.layers,
        layer_ratio=_layer_ratio(options.layers, options.top_layer * radius / thickness_mm),
    )


def _outline_focus(
    at_mm: tuple[float, float],
    section: ToolSection,
    pad: Pad,
    options: PressMeshOptions,
    o: OutlineMeshOptions,
) -> FocusOptions:
    place = np.asarray(at_mm, dtype=np.float64)
    room, normals = _room(pad, place)
    least = 2 * LEAST_CONTACT_MM
    points = clipped(thickened_hull(section.outline_mm, least) + place, room, normals)
    if isinstance(pad, DomePad):
        # Farther out the cap has fallen away from the tool by half of the depth.
        points = clipped(points, *_circle(place, math.sqrt(pad.dome_radius_mm * section.depth_mm)))
    if len(points) < 3:
        # Beside the pad; the place itself is refused with its distance from the edge.
        points = place[None]
    points = thickened_hull(points, least)
    center = centroid(points)
    half = np.abs(points - center).max(axis=0)
    size = float(np.sqrt(half.prod()))
    top = o.top * np.sqrt(size * pad.thickness_mm)
    # At the back a contact has spread.
    wider = np.maximum(1.0, BACK_SHARE * pad.thickness_mm / half)
    back = clipped(center + wider * (points - center), room, normals)
    radius = float(np.clip(size, LEAST_CONTACT_MM, LARGEST_CONTACT_MM))
    step = STEP_OF_TOP * top
    return FocusOptions(
        at_mm=(float(center[0]), float(center[1])),
        radius_mm=options.fine_radii * radius,
        size_mm=radius / options.elements_per_radius,
        core=o.core,
        rings=o.inner + o.outer + (rim_rings(pad) if isinstance(pad, HeightPad) else 0),
        layers=o.layers,
        layer_ratio=_layer_ratio(o.layers, top / pad.thickness_mm),
        outlines=(
            ContactOutline(points - center, step, o.inner),
            ContactOutline(without_short_sides(back - center), BACK_STEPS * step, o.inner),
        ),
    )


def _room(pad: Pad, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places on the border of what outlines may cover of a pad and normals outwards, [n, 2]; on a
    dome in the plane that touches it at ``place``."""
    if isinstance(pad, HeightPad):
        rim = float(rim_distances_mm(pad)[0])
        along = pad.outline.perimeter_mm * np.arange(_ROOM_SIDES) / _ROOM_SIDES
        places, normals = pad.outline.at_mm(along)
        return places - (rim + MIN_FOCUS_EDGE_MM) * normals, normals
    assert isinstance(pad, DomePad)
    return _circle(place, max(pad.arc_to_edge_mm(place) - MIN_FOCUS_EDGE_MM, LEAST_CONTACT_MM))


def _circle(center: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    angle = 2 * np.pi * np.arange(_ROOM_SIDES) / _ROOM_SIDES
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return center + radius * normals, normals


def _layer_ratio(layers: int, top_share: float) -> float:
    """Ratio of layers the uppermost of which is ``top_share`` of the whole, between 1 and
    ``LARGEST_LAYER_RATIO``."""
    return min(growth_factor(top_share, layers), LARGEST_LAYER_RATIO)
