# SPDX-License-Identifier: Apache-2.0
"""Structured tet mesh of a gel pad, of constant connectivity for every focus position.

The solver batches environments that share connectivity and differ in rest positions, so a press
anywhere on the pad gets a mesh that is fine there and still belongs to the same batch.
"""

from __future__ import annotations

import numpy as np

from cad.mesh.columns import check_range, check_unfolded, level_fractions
from cad.mesh.structured_plan import Focus, even_plan, focus_plan, rim_rings
from cad.mesh.structured_topology import grid_topology
from cad.parts.gel_pad import GelPad
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh

_LIMITS = {"core": (4, 64), "rings": (3, 128), "layers": (1, 64)}
MIN_FOCUS_EDGE_MM = 1.5
"""Least distance between a focus centre and the pad's outline [mm]."""


def structured_gel_mesh(
    pad: GelPad,
    *,
    focus_mm: tuple[float, float] | None = None,
    focus_radius_mm: float = 2.0,
    focus_size_mm: float = 0.25,
    core: int = 8,
    rings: int = 10,
    layers: int = 4,
    layer_ratio: float = 1.5,
    spread: float = 2.0,
    window_ring: int | None = None,
) -> TetMesh:
    """Mesh ``pad`` with an O-grid plan of (core + 1)^2 + 4 core rings nodes and layers + 1 levels.

    Without a focus the plan is even and the border between window and bond is exact. With
    ``focus_mm`` (xy in the gel frame [mm]) elements of ``focus_size_mm`` fill a disc of
    ``focus_radius_mm`` at the contact face, grow outside it, and are ``spread`` times as wide at
    the back; tets, faces and regions are the same arrays wherever the focus lies. The
    window of a focused mesh then follows the rings and is only approximate: both parts of the back
    are glued, so that no result depends on it.

    Layers grow by ``layer_ratio`` from the contact face down. Top nodes lie on
    ``pad.height_mm``, back nodes at exactly -thickness. Node = level * plan_count + plan node, with
    level 0 on the back. ``window_ring`` is the ring on the window's edge, shared out if not given.
    """
    for name, value in (("core", core), ("rings", rings), ("layers", layers)):
        low, high = _LIMITS[name]
        if not isinstance(value, int) or not low <= value <= high:
            raise InputError(f"{name} = {value!r} is not allowed; use a whole number {low}..{high}")
    if core % 2:
        raise InputError(f"core = {core} is odd; use an even number so that the corners match")
    check_range("layer_ratio", layer_ratio, 1.0, 4.0)
    check_range("spread", spread, 1.0, 10.0)
    if rings < rim_rings(pad) + 3:
        raise InputError(
            f"rings = {rings} is too few for a pad with rim {pad.rim!r}; use at least "
            f"{rim_rings(pad) + 3}"
        )
    window_ring = _window_ring(pad, rings) if window_ring is None else window_ring
    if not 1 <= window_ring <= rings - rim_rings(pad) - 1:
        raise InputError(
            f"window_ring = {window_ring} is not allowed; use 1 to {rings - rim_rings(pad) - 1}"
        )
    topology = grid_topology(core, rings, layers, window_ring)
    if focus_mm is None:
        top = even_plan(pad, core, rings, window_ring)
        bottom = top
        ratio = np.full(len(top), layer_ratio)
    else:
        focus = _checked_focus(pad, focus_mm, focus_radius_mm, focus_size_mm)
        wide = Focus(focus.center_mm, focus.radius_mm * spread, focus.size_mm * spread)
        top = focus_plan(pad, core, rings, focus)
        bottom = focus_plan(pad, core, rings, wide)
        # Far from the focus the cells are wide: thin layers there would only make slivers.
        far = np.linalg.norm(top - focus.center_mm, axis=1) - focus.radius_mm
        ratio = layer_ratio ** (1 - np.clip(far / pad.thickness_mm, 0, 1))
    nodes = _stack_levels(pad, top, bottom, level_fractions(layers, ratio))
    check_unfolded(nodes, topology.tets)
    return TetMesh(
        nodes_m=nodes * 1e-3,
        tets=topology.tets.copy(),
        faces=topology.faces.copy(),
        face_regions=topology.face_regions.copy(),
    )


def _stack_levels(
    pad: GelPad, top: np.ndarray, bottom: np.ndarray, fraction: np.ndarray
) -> np.ndarray:
    """Nodes of all levels [mm], shape [levels * plan_count, 3]; fraction [levels, plan_count]."""
    s = fraction[..., None]
    xy = (1 - s) * bottom + s * top
    z = -pad.thickness_mm * (1 - fraction) + pad.height_mm(xy) * fraction
    return np.concatenate([xy, z[..., None]], axis=-1).reshape(-1, 3)


def _window_ring(pad: GelPad, rings: int) -> int:
    """Ring on the window's edge: shares the rings by the widths of window and margin."""
    free = rings - rim_rings(pad)
    window = min(pad.window_x_mm, pad.window_y_mm) / 2
    margin_x = (pad.length_x_mm - pad.window_x_mm) / 2 - pad.rim_setback_mm()
    margin_y = (pad.length_y_mm - pad.window_y_mm) / 2 - pad.rim_setback_mm()
    margin = max(0.5 * (margin_x + margin_y), 0.1)
    share = round(free * margin / (margin + 0.6 * window))
    return free - int(np.clip(share, 1, free - 1))


def _checked_focus(
    pad: GelPad, center_mm: tuple[float, float], radius_mm: float, size_mm: float
) -> Focus:
    center = np.asarray(center_mm, dtype=np.float64)
    if center.shape != (2,) or not np.isfinite(center).all():
        raise InputError(f"focus_mm = {center_mm!r} is not a pair of numbers (x, y) in mm")
    edge = float(pad.inside_distance_mm(center)) - pad.rim_setback_mm()
    if edge < MIN_FOCUS_EDGE_MM:
        raise InputError(
            f"focus_mm = ({center[0]:g}, {center[1]:g}) lies {edge:.3f} mm inside the pad's "
            f"edge; allowed: at least {MIN_FOCUS_EDGE_MM:g} mm"
        )
    largest = min(pad.length_x_mm, pad.length_y_mm) / 2
    check_range("focus_radius_mm", radius_mm, 0.05, largest)
    check_range("focus_size_mm", size_mm, 0.01, radius_mm)
    return Focus((float(center[0]), float(center[1])), float(radius_mm), float(size_mm))
