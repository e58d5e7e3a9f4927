# SPDX-License-Identifier: Apache-2.0
"""The mesh of a sensor's gel for one press: fine around the contact, one connectivity for all."""

from __future__ import annotations

import math
import warnings
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
from taccel_lab.cad.mesh.mesh_pad import MeshPad
from taccel_lab.cad.mesh.pad_plan_focused import rim_distances_mm, rim_rings
from taccel_lab.cad.mesh.template import FoldedMeshError, growth_factor
from taccel_lab.cad.parts.dome_pad import DomePad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.bisection import bisected
from taccel_lab.geometry.contact_sweep import AT_REST, ContactSweep
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.presses.mesh_options import (
    DEFAULT_PRESS_MESH,
    EDGE_RADII,
    OutlineMeshOptions,
    PressMeshOptions,
)
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
NARROWER = (1.0, 0.7, 0.5, 0.35)
"""Widths of a ball's focus over the usual one, in the order in which they are tried: beside a pad's
corner the cells of a wide one fold. Counts and with them the connectivity stay."""
BISECTED_EDGES, BISECTED_RADII, BISECTED_GROWTH = 1.8, 1.3, 1.0
"""Mesh of an imported gel: longest edge of a tet over the elements' size, extent of the fine part
in contact radii, and how fast edges grow from there with the distance. A ball 0.5 mm deep in a Mini
of 2 mm edges takes 10,400 quadratic nodes; its force is within a per cent of that of 74,000."""
_ROOM_SIDES = 64
"""Lines that stand for the border of what a focus may cover of a pad."""


def press_mesh(
    family: str,
    parameters: Mapping[str, Any],
    at_mm: tuple[float, float],
    contact: float | ToolSection,
    options: PressMeshOptions = DEFAULT_PRESS_MESH,
    sweep: ContactSweep = AT_REST,
) -> TetMesh:
    """Gel pad of a catalogue sensor, graded around the contact at gel xy ``at_mm``.

    ``contact`` is a ball's contact radius [mm] or the section of another tool, see
    ``Indenter.contact``. All meshes of the same options and kind of contact share tets, faces
    and regions bitwise, whatever the place. ``sweep`` is the contact's way from there: a ball's
    mesh is made about its middle, rows of nodes under rims lie where it ends. Raises InputError
    for an unknown family or a place too close to the pad's edge.
    """
    found = sensor_family(family)
    return pad_press_mesh(found.parameters(parameters).pad(), at_mm, contact, options, sweep)


def refined_press_mesh(
    pad: Pad,
    at_mm: tuple[float, float],
    contact: float | ToolSection,
    options: PressMeshOptions = DEFAULT_PRESS_MESH,
    refinement: float = 1.0,
    sweep: ContactSweep = AT_REST,
) -> TetMesh:
    """Meshes a pad as ``press_mesh``, with more rings and layers where a ball's contact is small
    beside the pad, near its edge or moves far: connectivity depends on the contact, too. Then with
    ``refinement`` times as many elements along every side."""
    if isinstance(pad, HeightPad) and not isinstance(contact, ToolSection) and contact > 0:
        low, high = pad.outline.bounds_mm()
        radius = float(np.clip(contact, LEAST_CONTACT_MM, LARGEST_CONTACT_MM))
        options = options.for_ball(radius, pad.thickness_mm, 0.5 * float((high - low).mean()))
        edge_mm = _edge_mm(pad, at_mm, sweep)
        options = options.for_edge(radius, edge_mm).for_sweep(radius, sweep.length_mm)
        # A coarser mesh with fewer spokes than that would say nothing of this one.
        options = options.refined(refinement).for_edge(radius, edge_mm)
    else:
        options = (options.for_drag() if sweep.drags else options).refined(refinement)
    return pad_press_mesh(pad, at_mm, contact, options, sweep)


def _edge_mm(pad: Pad, at_mm: tuple[float, float], sweep: ContactSweep) -> float:
    """Least distance from the pad's edge on the way of a contact."""
    ends = np.asarray(at_mm, dtype=np.float64) + np.stack([np.zeros(2), sweep.way_mm])
    return float(pad.inside_distance_mm(ends).min())


def is_beside_edge(
    pad: Pad,
    at_mm: tuple[float, float],
    contact: float | ToolSection,
    sweep: ContactSweep = AT_REST,
) -> bool:
    """Say whether a ball comes so near to the pad's edge that its mesh has more spokes."""
    if isinstance(contact, ToolSection) or not isinstance(pad, HeightPad):
        return False
    return _edge_mm(pad, at_mm, sweep) < EDGE_RADII * contact


def _bisected_around(
    mesh: TetMesh,
    at_mm: tuple[float, float],
    contact: float | ToolSection,
    options: PressMeshOptions,
    sweep: ContactSweep,
) -> TetMesh:
    """Tets as small as ``options`` asks for wherever the contact comes, growing with the
    distance."""
    place = np.asarray(at_mm, dtype=np.float64)
    if isinstance(contact, ToolSection):
        contact = contact.moved(sweep)
        outline = thickened_hull(contact.outline_mm, 2 * LEAST_CONTACT_MM) + place
        middle = centroid(outline)
        # Half of the narrower side: what an edge is as wide as.
        radius = float(np.abs(outline - middle).max(axis=0).min())
    else:
        outline = place + np.stack([np.zeros(2), sweep.way_mm])[: 1 + (sweep.length_mm > 0)]
        radius = float(contact)
    if not radius > 0:
        raise InputError(f"a contact's radius must be above 0 mm, got {radius:g}")
    top = 1e3 * mesh.nodes_m[mesh.region_nodes(Region.CONTACT)]
    near = np.linalg.norm(top[:, None, :2] - outline[None], axis=-1).min(axis=1)
    if near.min() > 2 * np.linalg.norm(np.ptp(top[:, :2], axis=0)) / np.sqrt(len(top)):
        raise InputError(
            f"the contact face of the imported gel ends {near.min():.2f} mm away from "
            f"({place[0]:g}, {place[1]:g}) mm"
        )
    z = float(top[near.argmin(), 2])
    radius = float(np.clip(radius, LEAST_CONTACT_MM, LARGEST_CONTACT_MM))
    size = BISECTED_EDGES * radius / options.elements_per_radius
    fine = (BISECTED_RADII - 1.0) * radius
    sides = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
    ball = 0.0 if isinstance(contact, ToolSection) else radius

    def sizes_m(points_m: np.ndarray) -> np.ndarray:
        points = 1e3 * points_m
        beside = np.maximum(_outside_mm(points[:, :2], sides) - ball, 0.0)
        away = np.hypot(beside, points[:, 2] - z)
        return 1e-3 * (size + BISECTED_GROWTH * np.maximum(away - fine, 0.0))

    return bisected(mesh, sizes_m)


def _outside_mm(points: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Distance of points from a convex polygon [mm], 0 inside, [n, 2]; sides counter-clockwise,
    [m, 2, 2], a single point for a polygon of one."""
    along = sides[:, 1] - sides[:, 0]
    to = points[:, None] - sides[None, :, 0]
    squared = np.maximum((along**2).sum(axis=-1), 1e-30)
    share = np.clip((to * along).sum(axis=-1) / squared, 0.0, 1.0)
    distance = np.linalg.norm(to - share[..., None] * along, axis=-1).min(axis=1)
    turn = along[:, 0] * to[..., 1] - along[:, 1] * to[..., 0]
    inside = (turn >= 0).all(axis=1) & (len(sides) > 2)
    return np.where(inside, 0.0, distance)


def pad_press_mesh(
    pad: Pad,
    at_mm: tuple[float, float],
    contact: float | ToolSection,
    options: PressMeshOptions = DEFAULT_PRESS_MESH,
    sweep: ContactSweep = AT_REST,
) -> TetMesh:
    """Meshes as ``press_mesh`` a pad that need not be in the catalogue.

    The tets of a pad that is a mesh are bisected around the contact, which keeps no connectivity.
    """
    if isinstance(pad, MeshPad):
        return _bisected_around(pad.mesh, at_mm, contact, options, sweep)
    if not isinstance(contact, ToolSection):
        x, y = np.asarray(at_mm, dtype=np.float64) + 0.5 * sweep.way_mm
        return _around_a_ball(pad, _disc_focus((x, y), contact, pad.thickness_mm, options))
    contact = contact.moved(sweep)
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


def _around_a_ball(pad: Pad, focus: FocusOptions) -> TetMesh:
    """The mesh of the widest focus of ``NARROWER`` whose cells do not fold, with a warning when it
    is not the usual one."""
    folded: FoldedMeshError | None = None
    for share in NARROWER:
        size = {"radius_mm": share * focus.radius_mm, "size_mm": share * focus.size_mm}
        try:
            mesh = focused_gel_mesh(pad, replace(focus, **size))
        except FoldedMeshError as error:
            folded = folded or error
            continue
        if folded is not None:
            x, y = focus.at_mm
            warnings.warn(
                f"around ({x:g}, {y:g}) mm the gel cannot be meshed as finely as elsewhere: the "
                f"fine part is {share:.0%} as wide, which the stated error of the force counts",
                stacklevel=4,
            )
        return mesh
    assert folded is not None
    raise folded


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
        # Beside the pad; the place itself is rejected with its distance from the edge.
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
