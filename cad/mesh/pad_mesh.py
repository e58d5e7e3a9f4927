# SPDX-License-Identifier: Apache-2.0
"""Structured meshes of pads with a plane back, even or fine around a contact.

A column leads from its node of the back plan to its node of the top plan. The outermost column
climbs the wall; where a fillet is tangent to the wall an even mesh goes on along the lower part of
the fillet, so that the rim is followed without flat cells, and the columns beside it lean along.
The mesh of a press follows fillets with rings only: far from a contact its cells are too wide.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.cad.mesh.focus import MIN_FOCUS_EDGE_MM, FocusOptions
from taccel_lab.cad.mesh.grid import core_perimeter, grid_of
from taccel_lab.cad.mesh.pad_plan_even import EvenPlan, PadCounts, even_counts, even_plan
from taccel_lab.cad.mesh.pad_plan_focused import focus_plan, rim_distances_mm, rim_rings
from taccel_lab.cad.mesh.template import (
    Template,
    check_unfolded,
    columns_mm,
    level_fractions,
)
from taccel_lab.cad.mesh.tet_smoothing import SurfaceSheet, improve_worst_tets
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.guards import require_range

EVEN_DEG, FOCUSED_DEG = 12.0, 1.0
"""Tets with a smaller dihedral angle are smoothed [deg]; cells far from a contact may be flat."""
FILLET_DEG = 10.05
"""Tets on fillets that stay flatter make the nodes of the fillet slide, too [deg]."""
_FILLET_STEPS = 12
_EVEN_POWERS, _FOCUSED_POWERS = (4, 8, 16, 32), (4, 8)
EVEN_RATIO = 1.2
"""Thickness of a layer of an even mesh over that of the one above it."""
BACK_SPREAD = 2.0
"""Width of the cells of a focus at the back over those at the contact face."""
_KEPT_RADII = 0.3


def even_pad_mesh(pad: HeightPad, edge_mm: float, counts_of: HeightPad | None = None) -> TetMesh:
    """Structured mesh whose cells are about ``edge_mm`` wide and high; see ``gel_mesh``.

    Top nodes lie on ``pad.height_mm``, back nodes at exactly -thickness, wall nodes on the outline.
    """
    sized = pad if counts_of is None else counts_of
    largest = min(sized.thickness_mm, sized.window_x_mm / 2, sized.window_y_mm / 2)
    require_range("edge_mm", edge_mm, 0.2, largest)
    counts = even_counts(sized, edge_mm)
    template = _template(counts, mirrored=True)
    plan = even_plan(pad, counts)
    top = _on_face(pad, plan.top)
    if plan.fillet is not None:
        share = counts.side_arc / (counts.side_arc + counts.band)
        wall = len(plan.outline)
        # Ring by ring on the arcs: heights of the formula are steep near the wall.
        for k in range(counts.band + 1):
            fraction = 1 - (1 - share) * k / counts.band
            first = len(top) - (counts.band + 1 - k) * wall
            top[first : first + wall] = plan.fillet.points_mm(fraction)
    shares = level_fractions(counts.gel_layers, np.array(EVEN_RATIO))[:, None]
    levels = columns_mm(_on_back(pad, plan.back), top - [0, 0, pad.skin_top_mm], shares)
    if plan.fillet is not None:
        climbing = _wall_levels(pad, counts, plan)
        levels += _leaning(counts, climbing - levels[:, -len(plan.outline) :])
    nodes = template.nodes_mm(_with_skin(levels, top, counts.skin_layers))
    movable, sheet = _movable(template, counts, pad, focused=False)
    nodes = improve_worst_tets(
        nodes, template.grid.tets, movable, wanted_deg=EVEN_DEG, powers=_EVEN_POWERS, sheet=sheet
    )
    if plan.fillet is not None:
        # In small steps, which stop as soon as the angle is reached.
        nodes = improve_worst_tets(
            nodes,
            template.grid.tets,
            movable | _on_fillet(template, counts),
            wanted_deg=FILLET_DEG,
            powers=(8,) * _FILLET_STEPS,
            iterations=2,
            sheet=sheet,
        )
    check_unfolded(nodes, template.grid.tets)
    return template.mesh(nodes)


def focused_pad_mesh(pad: HeightPad, focus: FocusOptions) -> TetMesh:
    """Structured mesh that is fine around a contact; see ``focused_gel_mesh``.

    Elements of the focus's size fill its disc at the contact face, grow outside it, and are
    ``BACK_SPREAD`` times as wide at the back; with outlines rings follow those instead. Columns
    lean from the face's plan to the back's with the depth to the power ``focus.lean``. The window
    follows a ring and is only approximate: both parts of the back are glued, so that no result
    depends on it.
    """
    counts = _focused_counts(pad, focus)
    _check_focus(pad, focus)
    template = _template(counts, window_rings=counts.between - 1)
    wide = replace(
        focus, radius_mm=BACK_SPREAD * focus.radius_mm, size_mm=BACK_SPREAD * focus.size_mm
    )
    face, back = focus.outlines or (None, None)
    top = focus_plan(pad, focus, face)
    bottom = focus_plan(pad, wide, back)
    from_focus = top - np.asarray(focus.at_mm)
    # Fine cells of the contact face stay as they are.
    if face is None:
        far = np.linalg.norm(from_focus, axis=1) - focus.radius_mm
        kept = far < _KEPT_RADII * focus.radius_mm
    else:
        far = face.distance_mm(from_focus)
        kept = far < pad.thickness_mm
    # Far from the focus the cells are wide: thin layers there would only make slivers.
    ratio = focus.layer_ratio ** (1 - np.clip(far / pad.thickness_mm, 0, 1))
    shares = level_fractions(counts.gel_layers, ratio)
    foot, head = _on_back(pad, bottom), _on_face(pad, top)
    levels = columns_mm(foot, head - [0, 0, pad.skin_top_mm], shares)
    leaning = 1 - (1 - shares) ** focus.lean
    levels[..., :2] = columns_mm(foot, head, leaning)[..., :2]
    nodes = template.nodes_mm(_with_skin(levels, head, counts.skin_layers))
    movable, sheet = _movable(template, counts, pad, focused=True)
    movable[sheet.nodes[kept]] = False
    nodes = improve_worst_tets(
        nodes, template.grid.tets, movable, wanted_deg=FOCUSED_DEG, powers=_FOCUSED_POWERS,
        sheet=sheet,
    )  # fmt: skip
    check_unfolded(nodes, template.grid.tets)
    return template.mesh(nodes)


def _template(counts: PadCounts, *, mirrored: bool = False, window_rings: int = 0) -> Template:
    return Template(
        grid_of(counts.core, counts.rings, counts.layers, mirrored=mirrored),
        wall=Region.BOND if counts.sides_bonded else Region.SIDE,
        contact_rings=counts.rings,
        window_rings=window_rings,
        fillet_levels=counts.side_arc,
        skin_layers=counts.skin_layers,
        skin_rings=counts.skin_rings,
    )


def _focused_counts(pad: HeightPad, focus: FocusOptions) -> PadCounts:
    """The counts of a focus, of which skin and rings along the edge take their part."""
    edge_rings = rim_rings(pad)
    if focus.rings < edge_rings + 3:
        raise InputError(
            f"rings = {focus.rings} is too few for a pad with {edge_rings} rings along its edge; "
            f"use at least {edge_rings + 3}"
        )
    skin_layers = 1 if pad.skin_top_mm else 0
    if focus.layers < 1 + skin_layers:
        raise InputError(f"layers = {focus.layers} is too few for a gel with a skin; use 2 or more")
    return PadCounts(
        focus.core,
        between=focus.rings - edge_rings,
        band=edge_rings,
        gel_layers=focus.layers - skin_layers,
        skin_layers=skin_layers,
        skin_rings=int((rim_distances_mm(pad) < pad.skin_side_mm).sum()),
        sides_bonded=pad.sides_bonded,
    )


def _check_focus(pad: HeightPad, focus: FocusOptions) -> None:
    x, y = focus.at_mm
    low, high = pad.outline.bounds_mm()
    if not (low[0] <= x <= high[0] and low[1] <= y <= high[1]):
        raise InputError(
            f"at_mm = ({x:g}, {y:g}) lies outside the pad, which reaches over x [{low[0]:g}, "
            f"{high[0]:g}] and y [{low[1]:g}, {high[1]:g}] mm; allowed: at least "
            f"{MIN_FOCUS_EDGE_MM:g} mm inside the pad's edge"
        )
    edge = float(pad.inside_distance_mm(np.array([x, y]))) - float(rim_distances_mm(pad)[0])
    if edge < MIN_FOCUS_EDGE_MM:
        raise InputError(
            f"at_mm = ({x:g}, {y:g}) lies {edge:.3f} mm inside the pad's edge; allowed: at least "
            f"{MIN_FOCUS_EDGE_MM:g} mm"
        )
    focus.check_size(float(np.diff(pad.outline.bounds_mm(), axis=0).min()) / 2)


def _on_back(pad: HeightPad, plan: np.ndarray) -> np.ndarray:
    return np.column_stack([plan, np.full(len(plan), -pad.thickness_mm)])


def _on_face(pad: HeightPad, plan: np.ndarray) -> np.ndarray:
    return np.column_stack([plan, pad.height_mm(plan)])


def _with_skin(levels: np.ndarray, face: np.ndarray, skin_layers: int) -> np.ndarray:
    """Levels of the gel proper, then those of a skin up to the contact face."""
    shares = [k / skin_layers for k in range(1, skin_layers + 1)]
    return np.concatenate([levels, *(((1 - f) * levels[-1] + f * face)[None] for f in shares)])


def _wall_levels(pad: HeightPad, counts: PadCounts, plan: EvenPlan) -> np.ndarray:
    """Outermost columns: up the wall, then along the lower part of the fillet."""
    assert plan.fillet is not None
    total = counts.side_arc + counts.band
    arc = [plan.fillet.points_mm(k / total) for k in range(counts.side_arc + 1)]
    shares = level_fractions(counts.gel_layers - counts.side_arc, np.array(EVEN_RATIO))[:, None]
    return np.concatenate([columns_mm(_on_back(pad, plan.outline), arc[0], shares), arc[1:]])


def _leaning(counts: PadCounts, shift: np.ndarray) -> np.ndarray:
    """Shift of every column for that of the outermost ones, fading to none at the core.

    shift [levels, 4 core, 3] -> [levels, plan_count, 3].
    """
    rings = np.arange(1, counts.rings + 1) / counts.rings
    faded = shift[:, None] * rings[None, :, None, None]
    core = np.zeros((len(shift), (counts.core + 1) ** 2, 3))
    return np.concatenate([core, faded.reshape(len(shift), -1, 3)], axis=1)


def _movable(
    template: Template, counts: PadCounts, pad: HeightPad, *, focused: bool
) -> tuple[np.ndarray, SurfaceSheet]:
    """What may move to make tets rounder: bool by coordinate, shape [n, 3], and the contact face.

    Nodes of the window's edge, the rim band and the sides of skins stay. On the wall nodes climb,
    on the back and the contact face they slide. In a focused mesh the rings of the band stand over
    each other, and stay on all levels.
    """
    ring, level = template.grid.ring, template.grid.level
    free = np.ones((len(ring), 3), dtype=bool)
    wall, top = ring == counts.rings, level == counts.layers
    band = ring >= counts.rings - counts.band
    if not focused:
        band &= wall | top | ((ring == counts.rings - counts.skin_rings) & (counts.skin_rings > 0))
    free[band, :2] = False
    free[wall & (level >= counts.layers - counts.side_arc)] = False
    free[(level == 0) | top, 2] = False
    if counts.skin_layers:
        free[level >= counts.gel_layers] = False
    if isinstance(pad, GelPad) and not focused:
        free[core_perimeter(counts.core)] = False
    return free, SurfaceSheet(np.flatnonzero(top), pad.height_mm)


def _on_fillet(template: Template, counts: PadCounts) -> np.ndarray:
    """Coordinates in which nodes of a fillet's upper part may slide on it, bool, shape [n, 3].

    It is tangent to the crown, so that there is no edge to be left; but nodes that gather on one
    side leave long chords on the other.
    """
    ring, level = template.grid.ring, template.grid.level
    band = (ring >= counts.rings - counts.band) & (ring < counts.rings)
    free = np.zeros((len(ring), 3), dtype=bool)
    free[(level == counts.layers) & band, :2] = True
    return free
