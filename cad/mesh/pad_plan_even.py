# SPDX-License-Identifier: Apache-2.0
"""How many cells the mesh of a pad with a plane back has; where those of an even one lie in plan.

The counts fix the connectivity. The plans at the back and at the contact face share one O-grid. At
the back its core is the window (of a rounded rectangle) and the rings lead evenly from there to the
outline; at the contact face the outer rings follow the rim band, so that chamfers and fillets keep
their edges and no thin column reaches down to the back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.cad.mesh.grid import core_perimeter, plan_node_count, plan_quads
from taccel_lab.cad.mesh.outline_nodes import (
    MAX_ROUNDED_SAGITTA_MM,
    MAX_SAGITTA_MM,
    needed_cells,
    outline_nodes,
)
from taccel_lab.cad.mesh.plan_smoothing import smooth_plan
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.rim_fillet import FilletArc

NODE_BUDGET = 12_000
"""Nodes of an even mesh at an edge of 1 mm or more; large pads get wider cells in plan."""
_MAX_CORE = 64
_FILLET_SAGITTA_MM = 0.016
_FILLET_EDGE = 0.74
"""Spacing along an outline with a fillet in units of the edge: its cells are short across."""
_SEEN = 0.5
_LEAST_CELL = 0.6
"""Least width of a ring beside the core, in units of a cell."""
_FREE_CORE = 0.62
"""Size of the core of outlines that are no rectangles, in units of the outline."""


@dataclass(frozen=True)
class PadCounts:
    """Cells of a pad's mesh; equal counts give equal connectivity and regions."""

    core: int
    """Cells along each side of the core, which covers the window of an even mesh."""
    between: int
    """Rings between the core and the rim band (or the outline)."""
    band: int
    """Rings on the rim band, the part of a fillet next to the crown or the skin on the wall."""
    gel_layers: int
    skin_layers: int = 0
    side_arc: int = 0
    """Levels on the part of a fillet next to the wall."""
    skin_rings: int = 0
    """Outermost rings that belong to the skin."""
    sides_bonded: bool = False

    @property
    def rings(self) -> int:
        return self.between + self.band

    @property
    def layers(self) -> int:
        return self.gel_layers + self.skin_layers

    @property
    def node_count(self) -> int:
        return plan_node_count(self.core, self.rings) * (self.layers + 1)


def even_counts(pad: HeightPad, edge_mm: float) -> PadCounts:
    """Counts for elements of about ``edge_mm`` on ``pad``."""
    low, high = pad.outline.bounds_mm()
    width = float((high - low).mean())
    margin = width / 2 - (pad.window_x_mm + pad.window_y_mm) / 4
    band, side_arc = _band_cells(pad, edge_mm)
    skin_rings = _cells(pad.skin_side_mm, edge_mm) if pad.skin_side_mm else 0
    band = max(band, skin_rings)
    setback = max(pad.rim_setback_mm(), pad.skin_side_mm)
    between = max(0 if band else 1, round((margin - setback) / edge_mm))
    skin_layers = _cells(pad.skin_top_mm, edge_mm) if pad.skin_top_mm else 0
    gel = (pad.thickness_mm + pad.min_wall_mm()) / 2 - pad.skin_top_mm
    gel_layers = max(2 + side_arc, int(np.ceil(gel / edge_mm - 0.25)))
    spacing = edge_mm * (_FILLET_EDGE if pad.has_fillet else 1.0)
    needed = needed_cells(pad.outline, spacing, outline_sagitta_mm(pad))
    core = int(np.clip(2 * round(needed.mean() / 2), 4, _MAX_CORE))
    found = PadCounts(
        core, between, band, gel_layers, skin_layers, side_arc, skin_rings, pad.sides_bonded
    )
    budget = NODE_BUDGET * min(edge_mm, 1.0) ** -3
    while found.node_count > budget and found.core > 8:
        found = replace(found, core=found.core - 2)
    return found


def outline_sagitta_mm(pad: HeightPad) -> float:
    """How far chords of the outline may miss its arcs [mm]."""
    return MAX_ROUNDED_SAGITTA_MM if pad.has_fillet else MAX_SAGITTA_MM


def _cells(length_mm: float, edge_mm: float) -> int:
    return max(1, round(length_mm / edge_mm))


def _band_cells(pad: HeightPad, edge_mm: float) -> tuple[int, int]:
    """Rings over the rim band, and levels on the lower part of a fillet."""
    width = pad.rim_setback_mm()
    if not width:
        return 0, 0
    if pad.has_fillet:
        step = 2 * np.arccos(max(1 - _FILLET_SAGITTA_MM / width, 0.5))
        edge, _ = pad.outline.at_mm(np.linspace(0, pad.outline.perimeter_mm, 256))
        arc = pad.fillet_arc(edge)
        cells = max(2, int(np.ceil(arc.turns_rad.max() / min(step, edge_mm / width))))
        return cells - cells // 2, cells // 2
    if isinstance(pad, GelPad) and pad.rim == "arc":
        radius = pad.rim_radius_mm
        turn = float(np.arcsin(min(width / radius, 1.0)))
        step = min(2 * np.arccos(max(1 - MAX_SAGITTA_MM / radius, 0.5)), edge_mm / radius)
        return max(2, int(np.ceil(turn / step))), 0
    return _cells(width, edge_mm), 0


@dataclass(frozen=True)
class EvenPlan:
    """Plan nodes [mm], each shape [plan_count, 2], and the outline they end on."""

    back: np.ndarray
    top: np.ndarray
    outline: np.ndarray
    """Nodes on the outline, shape [4 core, 2]."""
    fillet: FilletArc | None
    """The fillet over each outline node."""


def even_plan(pad: HeightPad, counts: PadCounts) -> EvenPlan:
    """Plans of about even spacing with the given counts."""
    outline, normals = outline_nodes(pad.outline, counts.core, outline_sagitta_mm(pad))
    rectangle = isinstance(pad, GelPad)
    low, high = pad.outline.bounds_mm()
    t = np.linspace(-1, 1, counts.core + 1)
    square = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1)
    if rectangle:
        window = square * np.array([pad.window_x_mm / 2, pad.window_y_mm / 2])
    else:
        window = (low + high) / 2 + _FREE_CORE * square * (high - low) / 2
    # Walls of the skin are vertical: their rings lie at the same place in both plans.
    held = counts.band if counts.skin_rings else 0
    inner = outline - normals * pad.skin_side_mm if held else outline
    rings = counts.rings - held
    back = _loops(window, inner, np.arange(1, rings + 1) / rings)
    back = _smoothed(back, counts.core, rings, rectangle)
    arc = None
    if pad.has_fillet:
        arc = pad.fillet_arc(outline)
    if not counts.band:
        top = back
    elif held:
        ends = [outline + (inner - outline) * k / held for k in range(held - 1, -1, -1)]
        back = np.concatenate([back, *ends])
        top = back
    else:
        core = back[: (counts.core + 1) ** 2].reshape(window.shape)
        top = _banded(pad, counts, core, outline, normals, arc)
    return EvenPlan(back, top, outline, arc)


def _loops(core: np.ndarray, inner: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    """Core nodes and rings from the core's edge to ``inner`` at the given fractions."""
    edge = core.reshape(-1, 2)[core_perimeter(len(core) - 1)]
    loops = [edge + (inner - edge) * f for f in fractions]
    return np.concatenate([core.reshape(-1, 2), *loops])


def _smoothed(xy: np.ndarray, core: int, rings: int, window_held: bool) -> np.ndarray:
    """Smooth all but the last ring and a held window's edge."""
    free = np.ones(xy.shape, dtype=bool)
    free[len(xy) - 4 * core :] = False
    if window_held:
        free[core_perimeter(core)] = False
    return smooth_plan(xy, plan_quads(core, rings), free)


def _banded(
    pad: HeightPad, counts: PadCounts, core_nodes: np.ndarray, outline: np.ndarray,
    normals: np.ndarray, arc: FilletArc | None,
) -> np.ndarray:  # fmt: skip
    """Plan at the contact face whose last rings lie on the rim band, over the core of the back."""
    core, band, between = counts.core, counts.band, counts.between
    if arc is not None:
        total = band + counts.side_arc
        ends = [arc.points_mm(k / total)[:, :2] for k in range(total, counts.side_arc - 1, -1)]
        inner, ends = ends[0], ends[1:]
    elif isinstance(pad, GelPad) and pad.has_band and pad.rim_mm > 0.6 * pad.corner_radius_mm:
        half = np.array([pad.length_x_mm, pad.length_y_mm]) / 2 - pad.rim_mm
        t = np.linspace(-1, 1, core + 1)
        square = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1)
        even = square.reshape(-1, 2)[core_perimeter(core)]
        # Between even spacing and that of the outline, so that spokes lean less.
        seen = outline / (half + pad.rim_mm)
        inner = half * np.where(np.abs(even) == 1, even, (1 - _SEEN) * even + _SEEN * seen)
        fractions = _band_fractions(pad, band)
        ends = [inner + (outline - inner) * f for f in fractions]
    else:
        fractions = _band_fractions(pad, band)
        ends = [outline - normals * pad.rim_setback_mm() * (1 - f) for f in fractions]
        inner = outline - normals * pad.rim_setback_mm()
    # A band wider than the window's margin leaves the core less room than it has at the back.
    room = np.abs(inner).max(axis=0) * (1 - _LEAST_CELL * 2 * between / core)
    core_nodes = core_nodes * np.minimum(room / np.abs(core_nodes).max(axis=(0, 1)), 1)
    if between:
        plan = _loops(core_nodes, inner, np.arange(1, between + 1) / between)
        free = np.zeros(plan.shape, dtype=bool)
        free[core_nodes.size // 2 : len(plan) - 4 * core] = True
    else:
        plan = core_nodes.reshape(-1, 2).copy()
        free = np.ones(plan.shape, dtype=bool)
        plan[core_perimeter(core)] = inner
        free[core_perimeter(core)] = False
    plan = smooth_plan(plan, plan_quads(core, between), free)
    return np.concatenate([plan, *ends])


def _band_fractions(pad: HeightPad, band: int) -> np.ndarray:
    """Where the rings lie on the band, from after its inner edge to the wall (1)."""
    even = np.arange(1, band + 1) / band
    if isinstance(pad, GelPad) and pad.rim == "arc":
        ratio = pad.rim_mm / pad.rim_radius_mm
        return np.sin(even * np.arcsin(ratio)) / ratio
    return even
