# SPDX-License-Identifier: Apache-2.0
"""Where the nodes of an even mesh lie in plan, at the back and at the contact face.

Both plans share one O-grid. At the back its core is the window (of a rounded rectangle) and the
rings lead evenly from there to the outline; at the contact face the outer rings follow the rim
band, so that chamfers and fillets keep their edges and no thin column reaches down to the back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.cad.mesh.grid import core_perimeter, plan_quads
from taccel_lab.cad.mesh.outline_nodes import outline_nodes
from taccel_lab.cad.mesh.pad_counts import PadCounts, outline_sagitta_mm
from taccel_lab.cad.mesh.plan_smoothing import smooth_plan
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.rim_fillet import FilletArc, fillet_arc

_SEEN = 0.5
_LEAST_CELL = 0.6
"""Least width of a ring beside the core, in units of a cell."""
_FREE_CORE = 0.62
"""Size of the core of outlines that are no rectangles, in units of the outline."""


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
    inner = outline - normals * pad.skin_wall_mm if held else outline
    rings = counts.rings - held
    back = _loops(window, inner, np.arange(1, rings + 1) / rings)
    back = _smoothed(back, counts.core, rings, rectangle)
    arc = None
    if pad.has_fillet:
        arc = fillet_arc(pad.outline, pad.rim_setback_mm(), pad.crown_mm, pad.crown_slope, outline)
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
