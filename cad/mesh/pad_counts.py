# SPDX-License-Identifier: Apache-2.0
"""How many cells the mesh of a pad with a plane back has: the counts fix its connectivity."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.cad.mesh.grid import plan_node_count
from taccel_lab.cad.mesh.outline_nodes import MAX_ROUNDED_SAGITTA_MM, MAX_SAGITTA_MM, needed_cells
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.rim_fillet import fillet_arc

NODE_BUDGET = 12_000
"""Nodes of an even mesh at an edge of 1 mm or more; large pads get wider cells in plan."""
_MAX_CORE = 64
_FILLET_SAGITTA_MM = 0.016
_FILLET_EDGE = 0.74
"""Spacing along an outline with a fillet in units of the edge: its cells are short across."""


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
    skin_rings = _cells(pad.skin_wall_mm, edge_mm) if pad.skin_wall_mm else 0
    band = max(band, skin_rings)
    setback = max(pad.rim_setback_mm(), pad.skin_wall_mm)
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
        arc = fillet_arc(pad.outline, width, pad.crown_mm, pad.crown_slope, edge)
        cells = max(2, int(np.ceil(arc.turns_rad.max() / min(step, edge_mm / width))))
        return cells - cells // 2, cells // 2
    if isinstance(pad, GelPad) and pad.rim == "arc":
        radius = pad.rim_radius_mm
        turn = float(np.arcsin(min(width / radius, 1.0)))
        step = min(2 * np.arccos(max(1 - MAX_SAGITTA_MM / radius, 0.5)), edge_mm / radius)
        return max(2, int(np.ceil(turn / step))), 0
    return _cells(width, edge_mm), 0
