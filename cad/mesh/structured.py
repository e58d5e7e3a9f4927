# SPDX-License-Identifier: Apache-2.0
"""Structured tet mesh of a pad, fine around a contact, of one connectivity wherever that lies.

The solver batches environments that share connectivity and differ in rest positions, so a press
anywhere on the pad gets a mesh that is fine there and still belongs to the same batch.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.mesh.columns import check_range, check_unfolded, level_fractions
from taccel_lab.cad.mesh.contact_plan import ContactOutline, contact_plan
from taccel_lab.cad.mesh.structured_plan import Focus, focus_plan, rim_distances_mm, rim_rings
from taccel_lab.cad.mesh.structured_topology import grid_topology, ring_of_node
from taccel_lab.cad.mesh.tet_smoothing import Sheet, improve_worst_tets
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh

_LIMITS = {"core": (4, 64), "rings": (3, 128), "layers": (1, 64)}
WANTED_DEG = 1.0
"""Tets with a smaller dihedral angle are smoothed [deg]."""
_POWERS = (4, 8)
_KEPT_RADII = 0.3
MIN_FOCUS_EDGE_MM = 1.5
"""Least distance between a focus centre and the pad's outline [mm]."""


def structured_gel_mesh(
    pad: HeightPad,
    *,
    focus_mm: tuple[float, float],
    focus_radius_mm: float = 2.0,
    focus_size_mm: float = 0.25,
    core: int = 8,
    rings: int = 10,
    layers: int = 4,
    layer_ratio: float = 1.5,
    spread: float = 2.0,
    outlines: tuple[ContactOutline, ContactOutline] | None = None,
    lean: float = 1.0,
    window_ring: int | None = None,
) -> TetMesh:
    """Mesh ``pad`` with an O-grid plan of (core + 1)^2 + 4 core rings nodes and layers + 1 levels.

    Elements of ``focus_size_mm`` fill a disc of ``focus_radius_mm`` about ``focus_mm`` (xy in the
    gel frame [mm]) at the contact face, grow outside it, and are ``spread`` times as wide at the
    back. With ``outlines`` at the contact face and at the back rings follow those instead, see
    ``contact_plan``. Columns lean from the face's plan to the back's with the depth to the power
    ``lean``. Tets, faces, regions
    and layers are the same arrays wherever the focus lies and for all pads of one kind of rim and
    skin. The window follows the ring ``window_ring`` and is only approximate: both
    parts of the back are glued, so that no result depends on it.

    Layers grow by ``layer_ratio`` from the contact face down; a skin on the contact face is the
    uppermost layer. Top nodes lie on ``pad.height_mm``, back nodes at exactly -thickness. Node =
    level * plan_count + plan node, with level 0 on the back.
    """
    for name, value in (("core", core), ("rings", rings), ("layers", layers)):
        low, high = _LIMITS[name]
        if not isinstance(value, int) or not low <= value <= high:
            raise InputError(f"{name} = {value!r} is not allowed; use a whole number {low}..{high}")
    if core % 2:
        raise InputError(f"core = {core} is odd; use an even number so that the corners match")
    check_range("layer_ratio", layer_ratio, 1.0, 4.0)
    check_range("spread", spread, 1.0, 10.0)
    edge_rings = rim_rings(pad)
    if rings < edge_rings + 3:
        raise InputError(
            f"rings = {rings} is too few for a pad with {edge_rings} rings along its edge; use at "
            f"least {edge_rings + 3}"
        )
    skin_layers = 1 if pad.skin_top_mm else 0
    if layers < 1 + skin_layers:
        raise InputError(f"layers = {layers} is too few for a gel with a skin; use at least 2")
    window_ring = rings - edge_rings - 1 if window_ring is None else window_ring
    if not 1 <= window_ring <= rings - edge_rings - 1:
        raise InputError(
            f"window_ring = {window_ring} is not allowed; use 1 to {rings - edge_rings - 1}"
        )
    topology = grid_topology(core, rings, layers, window_ring)
    focus = _checked_focus(pad, focus_mm, focus_radius_mm, focus_size_mm)
    wide = Focus(focus.center_mm, focus.radius_mm * spread, focus.size_mm * spread)
    around = (None, None) if outlines is None else tuple(outline.round for outline in outlines)
    top = focus_plan(pad, core, rings, focus, around[0])
    bottom = focus_plan(pad, core, rings, wide, around[1])
    # Far from the focus the cells are wide: thin layers there would only make slivers.
    center = np.asarray(focus.center_mm)
    if outlines is None:
        far = np.linalg.norm(top - center, axis=1) - focus.radius_mm
        kept = far < _KEPT_RADII * focus.radius_mm
    else:
        free = rings - edge_rings
        top = contact_plan(top, core, free, center, outlines[0])
        bottom = contact_plan(bottom, core, free, center, outlines[1])
        far = outlines[0].distance_mm(top - center)
        kept = far < pad.thickness_mm
    ratio = layer_ratio ** (1 - np.clip(far / pad.thickness_mm, 0, 1))
    fractions = level_fractions(layers - skin_layers, ratio)
    nodes = _stack_levels(pad, top, bottom, fractions, lean)
    movable = _movable(pad, core, rings, layers)
    # Fine cells of the contact face stay as they are.
    movable[-len(top) :][kept] = False
    sheet = Sheet(np.arange(len(nodes) - len(top), len(nodes)), pad.height_mm)
    nodes = improve_worst_tets(
        nodes, topology.tets, movable, wanted_deg=WANTED_DEG, powers=_POWERS, sheet=sheet
    )
    check_unfolded(nodes, topology.tets)
    regions = topology.face_regions.copy()
    if pad.sides_bonded:
        regions[regions == int(Region.SIDE)] = Region.BOND
    level, plan = np.divmod(topology.tets, len(top))
    skin = (
        (level >= layers - skin_layers).all(axis=1) if skin_layers else np.zeros(len(level), bool)
    )
    if pad.skin_wall_mm:
        inside = int((rim_distances_mm(pad) < pad.skin_wall_mm).sum())
        skin |= (ring_of_node(core, rings)[plan] >= rings - inside).all(axis=1)
    return TetMesh(
        nodes_m=nodes * 1e-3,
        tets=topology.tets.copy(),
        faces=topology.faces.copy(),
        face_regions=regions,
        tet_layers=np.asarray(skin, dtype=np.int32),
    )


def _movable(pad: HeightPad, core: int, rings: int, layers: int) -> np.ndarray:
    """What may move to make tets rounder, bool by coordinate, shape [n, 3].

    Nodes slide on the back and the contact face and climb the wall; rings along the edge and
    levels on the border of a skin stay.
    """
    edge_rings = rim_rings(pad)
    ring = np.tile(ring_of_node(core, rings), layers + 1)
    level = np.repeat(np.arange(layers + 1), len(ring) // (layers + 1))
    free = np.ones((len(ring), 3), dtype=bool)
    free[ring >= rings - edge_rings, :2] = False
    free[(level == 0) | (level == layers), 2] = False
    if pad.skin_top_mm:
        free[level >= layers - 1] = False
    return free


def _stack_levels(
    pad: HeightPad, top: np.ndarray, bottom: np.ndarray, fraction: np.ndarray, lean: float
) -> np.ndarray:
    """Nodes of all levels [mm], shape [levels * plan_count, 3]; fraction [levels, plan_count].

    A skin on the contact face adds a level above those of the gel proper.
    """
    s = fraction[..., None]
    back = np.column_stack([bottom, np.full(len(bottom), -pad.thickness_mm)])
    face = np.column_stack([top, pad.height_mm(top)])
    levels = (1 - s) * back + s * (face - [0, 0, pad.skin_top_mm])
    t = (1 - s) ** lean
    levels[..., :2] = t * back[..., :2] + (1 - t) * face[..., :2]
    if pad.skin_top_mm:
        levels = np.concatenate([levels, face[None]])
    return levels.reshape(-1, 3)


def _checked_focus(
    pad: HeightPad, center_mm: tuple[float, float], radius_mm: float, size_mm: float
) -> Focus:
    center = np.asarray(center_mm, dtype=np.float64)
    if center.shape != (2,) or not np.isfinite(center).all():
        raise InputError(f"focus_mm = {center_mm!r} is not a pair of numbers (x, y) in mm")
    edge = float(pad.inside_distance_mm(center)) - float(rim_distances_mm(pad)[0])
    if edge < MIN_FOCUS_EDGE_MM:
        raise InputError(
            f"focus_mm = ({center[0]:g}, {center[1]:g}) lies {edge:.3f} mm inside the pad's "
            f"edge; allowed: at least {MIN_FOCUS_EDGE_MM:g} mm"
        )
    largest = float(np.diff(pad.outline.bounds_mm(), axis=0).min()) / 2
    check_range("focus_radius_mm", radius_mm, 0.05, largest)
    check_range("focus_size_mm", size_mm, 0.01, radius_mm)
    return Focus((float(center[0]), float(center[1])), float(radius_mm), float(size_mm))
