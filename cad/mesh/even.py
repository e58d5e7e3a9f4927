# SPDX-License-Identifier: Apache-2.0
"""Even structured tet meshes of pads with a flat back: columns between two plans.

A column leads from its node of the back plan to its node of the top plan. The outermost column
climbs the wall; where a fillet is tangent to the wall it goes on along the lower part of the
fillet, so that the rim is followed without flat cells, and the columns beside it lean along.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.mesh.columns import check_range, check_unfolded, level_fractions
from taccel_lab.cad.mesh.even_counts import EvenCounts, even_counts
from taccel_lab.cad.mesh.even_plan import EvenPlan, even_plan
from taccel_lab.cad.mesh.structured_topology import core_perimeter, grid_topology, ring_of_node
from taccel_lab.cad.mesh.tet_smoothing import Sheet, improve_worst_tets
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.geometry import Region, TetMesh

WANTED_DEG = 12.0
"""Tets with a smaller dihedral angle are smoothed [deg]."""
LEAST_DEG = 10.05
"""Tets on fillets that stay flatter make the nodes of the fillet slide, too [deg]."""
_FILLET_STEPS = 12
_POWERS = (4, 8, 16, 32)
LAYER_RATIO = 1.2
"""Thickness of a layer over that of the one above it."""


def even_gel_mesh(
    pad: HeightPad, edge_mm: float = 1.0, *, counts_of: HeightPad | None = None
) -> TetMesh:
    """Structured mesh whose cells are about ``edge_mm`` wide and high.

    Top nodes lie on ``pad.height_mm``, back nodes at exactly -thickness, wall nodes on the outline.
    Node = level * plan_count + plan node, with level 0 on the back. ``counts_of`` names the pad
    whose dimensions choose the counts: with the same one, every pad of a sweep has the same
    connectivity and regions.

    Raises InputError for an edge out of bounds, or when cells fold over.
    """
    sized = pad if counts_of is None else counts_of
    largest = min(sized.thickness_mm, sized.window_x_mm / 2, sized.window_y_mm / 2)
    check_range("edge_mm", edge_mm, 0.2, largest)
    return counted_gel_mesh(pad, even_counts(sized, edge_mm))


def counted_gel_mesh(pad: HeightPad, counts: EvenCounts) -> TetMesh:
    """Even mesh with the given counts."""
    topology = grid_topology(counts.core, counts.rings, counts.layers, 0, mirrored=True)
    nodes = _stacked(pad, counts, even_plan(pad, counts))
    tets = topology.tets.copy()
    sliding, sheet = _movable(pad, counts)
    nodes = improve_worst_tets(
        nodes, tets, sliding, wanted_deg=WANTED_DEG, powers=_POWERS, sheet=sheet
    )
    if pad.has_fillet:
        # In small steps, which stop as soon as the angle is reached.
        nodes = improve_worst_tets(
            nodes,
            tets,
            sliding | _on_fillet(counts),
            wanted_deg=LEAST_DEG,
            powers=(8,) * _FILLET_STEPS,
            iterations=2,
            sheet=sheet,
        )
    check_unfolded(nodes, tets)
    return TetMesh(
        nodes_m=nodes * 1e-3,
        tets=tets,
        faces=topology.faces.copy(),
        face_regions=_face_regions(topology.faces, topology.face_regions, counts),
        tet_layers=_tet_layers(tets, counts),
    )


def _stacked(pad: HeightPad, counts: EvenCounts, plan: EvenPlan) -> np.ndarray:
    """Nodes of all levels [mm], shape [levels plan_count, 3]."""
    wall = len(plan.outline)
    back = np.column_stack([plan.back, np.full(len(plan.back), -pad.thickness_mm)])
    top = np.column_stack([plan.top, pad.height_mm(plan.top)])
    if plan.fillet is not None:
        share = counts.side_arc / (counts.side_arc + counts.band)
        # Ring by ring on the arcs: heights of the formula are steep near the wall.
        for k in range(counts.band + 1):
            fraction = 1 - (1 - share) * k / counts.band
            first = len(top) - (counts.band + 1 - k) * wall
            top[first : first + wall] = plan.fillet.points_mm(fraction)
    skin = top - [0, 0, pad.skin_top_mm]
    s = level_fractions(counts.gel_layers, np.array(LAYER_RATIO))[:, None, None]
    levels = (1 - s) * back + s * skin
    if plan.fillet is not None:
        climbing = _wall_levels(pad, counts, plan)
        levels += _leaning(counts, climbing - levels[:, -wall:])
    for k in range(1, counts.skin_layers + 1):
        f = k / counts.skin_layers
        levels = np.concatenate([levels, ((1 - f) * skin + f * top)[None]])
    return levels.reshape(-1, 3)


def _wall_levels(pad: HeightPad, counts: EvenCounts, plan: EvenPlan) -> np.ndarray:
    """Outermost columns: up the wall, then along the lower part of the fillet."""
    assert plan.fillet is not None
    total = counts.side_arc + counts.band
    arc = [plan.fillet.points_mm(k / total) for k in range(counts.side_arc + 1)]
    steps = counts.gel_layers - counts.side_arc
    foot = np.column_stack([plan.outline, np.full(len(plan.outline), -pad.thickness_mm)])
    s = level_fractions(steps, np.array(LAYER_RATIO))[:, None, None]
    return np.concatenate([(1 - s) * foot + s * arc[0], np.array(arc[1:])])


def _movable(pad: HeightPad, counts: EvenCounts) -> tuple[np.ndarray, Sheet]:
    """What may move to make tets rounder: bool by coordinate, shape [n, 3], and the contact face.

    Nodes of the window's edge, the rim band and the sides of skins stay. On the wall nodes climb,
    on the back and the contact face they slide.
    """
    ring, level = _ring_and_level(counts)
    free = np.ones((len(ring), 3), dtype=bool)
    wall = ring == counts.rings
    free[wall, :2] = False
    free[wall & (level >= counts.layers - counts.side_arc)] = False
    free[level == 0, 2] = False
    edge = core_perimeter(counts.core)
    if isinstance(pad, GelPad):
        free[edge] = False
    top = level == counts.layers
    free[top, 2] = False
    free[top & (ring >= counts.rings - counts.band), :2] = counts.band == 0
    free[top & wall] = False
    if counts.skin_layers:
        free[level >= counts.gel_layers] = False
    if counts.skin_rings:
        free[ring == counts.rings - counts.skin_rings, :2] = False
    return free, Sheet(np.flatnonzero(top), pad.height_mm)


def _ring_and_level(counts: EvenCounts) -> tuple[np.ndarray, np.ndarray]:
    """Ring and level of every node, shape [n] each."""
    ring = np.tile(ring_of_node(counts.core, counts.rings), counts.layers + 1)
    return ring, np.repeat(np.arange(counts.layers + 1), counts.plan_count)


def _on_fillet(counts: EvenCounts) -> np.ndarray:
    """Coordinates in which nodes of a fillet's upper part may slide on it, bool, shape [n, 3].

    It is tangent to the crown, so that there is no edge to be left; but nodes that gather on one
    side leave long chords on the other.
    """
    ring, level = _ring_and_level(counts)
    band = (ring >= counts.rings - counts.band) & (ring < counts.rings)
    free = np.zeros((len(ring), 3), dtype=bool)
    free[(level == counts.layers) & band, :2] = True
    return free


def _leaning(counts: EvenCounts, shift: np.ndarray) -> np.ndarray:
    """Shift of every column for that of the outermost ones, fading to none at the core.

    shift [levels, 4 core, 3] -> [levels, plan_count, 3].
    """
    rings = np.arange(1, counts.rings + 1) / counts.rings
    faded = shift[:, None] * rings[None, :, None, None]
    core = np.zeros((len(shift), (counts.core + 1) ** 2, 3))
    return np.concatenate([core, faded.reshape(len(shift), -1, 3)], axis=1)


def _face_regions(faces: np.ndarray, found: np.ndarray, counts: EvenCounts) -> np.ndarray:
    level = faces // counts.plan_count
    regions = found.copy()
    side = regions == int(Region.SIDE)
    if counts.side_arc:
        on_fillet = (level >= counts.layers - counts.side_arc).all(axis=1)
        regions[side & on_fillet] = Region.CONTACT
    if counts.sides_bonded:
        regions[side & (regions == int(Region.SIDE))] = Region.BOND
    return regions


def _tet_layers(tets: np.ndarray, counts: EvenCounts) -> np.ndarray:
    level, plan = np.divmod(tets, counts.plan_count)
    ring = ring_of_node(counts.core, counts.rings)[plan]
    above = (level >= counts.gel_layers).all(axis=1) & (counts.skin_layers > 0)
    beside = (ring >= counts.rings - counts.skin_rings).all(axis=1) & (counts.skin_rings > 0)
    return np.asarray(above | beside, dtype=np.int32)
