# SPDX-License-Identifier: Apache-2.0
"""Structured tet meshes of dome shells: an O-grid on the cap, layers through the thickness."""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.cad.mesh.columns import check_unfolded
from taccel_lab.cad.mesh.contact_plan import ContactOutline
from taccel_lab.cad.mesh.dome_columns import (
    FOLD_REMEDY,
    Columns,
    DomeGrid,
    check_edge,
    dome_columns,
    even_drops,
    focused_sizes,
    graded_shares,
)
from taccel_lab.cad.mesh.dome_plan import (
    LARGEST_CORE,
    CapGrid,
    even_cap,
    focused_cap,
    outside_outline_mm,
)
from taccel_lab.cad.mesh.structured_plan import Focus
from taccel_lab.cad.mesh.structured_topology import grid_topology, ring_of_node
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.geometry import Region, TetMesh

_SPREAD = 8.0
"""Thickness of the gel over the size of the cells under a contact at the core."""
_LEAN = 0.5
"""How far columns at the edge of the fine part may lean outward, over the thickness."""


def even_shell_mesh(pad: ShellDomePad, edge_mm: float = 1.0) -> TetMesh:
    """Mesh of ``pad`` whose cells are about ``edge_mm`` large; all borders are exact circles."""
    check_edge(edge_mm, pad.cap_radius_mm / 2)
    grid, layers = _even_grid(pad, edge_mm)
    disc = even_cap(grid.cap, pad.cap_angle, pad.window_angle if pad.window_deg else None)
    drops = even_drops(pad.skirt_mm, grid.free_rings)
    columns = dome_columns(grid, disc, pad.cap_angle, drops)
    shares = np.linspace(0, 1, layers + 1)[:, None] * np.ones(len(columns.theta))
    return _assemble(pad, grid, columns, shares)


def focused_shell_mesh(
    pad: ShellDomePad,
    focus: Focus,
    outlines: tuple[ContactOutline, ContactOutline] | None,
    *,
    core: int,
    rings: int,
    layers: int,
    layer_ratio: float,
) -> TetMesh:
    """Mesh of ``pad``, fine around a contact; the same connectivity wherever the contact is.

    The window's border then follows the rings and is only approximate: both sides of it are glued.
    """
    skirt = max(2, rings // 5) if pad.skirt_mm else 0
    share = pad.window_angle / pad.cap_angle
    window = int(np.clip(round(share * rings), 1, rings - 1)) if pad.window_deg else 0
    grid = DomeGrid(CapGrid(core, window, rings), free_rings=skirt, bonded_rings=0)
    face, back = outlines or (None, None)
    disc = focused_cap(grid.cap, pad.cap_angle, pad.dome_radius_mm, focus, face)
    drops = even_drops(pad.skirt_mm, skirt)
    columns = dome_columns(grid, disc, pad.cap_angle, drops)
    outside = columns.on_sphere_and_wall(pad.dome_radius_mm, -pad.dome_radius_mm)
    # Wider cells at the core, as far as the thickness asks for: tall thin tets are flat ones.
    wide = min(
        max(1.0, pad.thickness_mm / (_SPREAD * focus.size_mm)),
        1 + _LEAN * pad.thickness_mm / focus.radius_mm,
    )
    deep = Focus(focus.center_mm, wide * focus.radius_mm, wide * focus.size_mm)
    below = focused_cap(grid.cap, pad.cap_angle, pad.dome_radius_mm, deep, back)
    base = dome_columns(grid, below, pad.cap_angle, drops)
    away = outside_outline_mm(disc, pad.cap_angle, pad.dome_radius_mm, focus, face)
    sizes = focused_sizes(grid, outside, away, pad.thickness_mm, layers, layer_ratio)
    length = np.full(len(sizes), pad.thickness_mm)
    return _assemble(pad, grid, columns, graded_shares(sizes, length, layers), base)


def _even_grid(pad: ShellDomePad, edge: float) -> tuple[DomeGrid, int]:
    """Counts for about even cells of size ``edge`` [mm] on the contact face, and the layers."""
    radius = pad.dome_radius_mm
    core = int(np.clip(2 * round(math.pi * pad.cap_radius_mm / (4 * edge)), 4, 64))
    arc, seen = radius * pad.cap_angle, radius * pad.window_angle
    half = min(0.5 * core * edge, LARGEST_CORE * seen)
    inner = max(2, round((seen - half) / edge))
    outer = max(1, round((arc - seen) / edge)) if pad.window_deg else 0
    layers = max(1 if pad.thickness_mm < 0.5 * edge else 2, round(pad.thickness_mm / edge))
    skirt = max(1, round(pad.skirt_mm / edge)) if pad.skirt_mm else 0
    cap = CapGrid(core, inner if outer else 0, inner + outer)
    return DomeGrid(cap, free_rings=skirt, bonded_rings=0), layers


def _assemble(
    pad: ShellDomePad,
    grid: DomeGrid,
    columns: Columns,
    shares: np.ndarray,
    base: Columns | None = None,
) -> TetMesh:
    """``shares``: height of each level over the core, 0 to 1, shape [layers + 1, plan nodes]."""
    layers = len(shares) - 1
    center = -pad.dome_radius_mm
    outside = columns.on_sphere_and_wall(pad.dome_radius_mm, center)
    inside = (base or columns).on_sphere_and_wall(pad.core_radius_mm, center)
    share = shares[..., None]
    nodes = ((1 - share) * inside + share * outside).reshape(-1, 3)
    topology = grid_topology(grid.cap.core, grid.rings, layers, max(grid.cap.window_rings, 1))
    check_unfolded(nodes, topology.tets, remedy=FOLD_REMEDY)
    return TetMesh(
        nodes_m=nodes * 1e-3,
        tets=topology.tets.copy(),
        faces=topology.faces.copy(),
        face_regions=_regions(pad, grid, topology.faces, topology.plan_count, layers),
    )


def _regions(
    pad: ShellDomePad, grid: DomeGrid, faces: np.ndarray, plan_count: int, layers: int
) -> np.ndarray:
    """Region of each face from the levels and rings of its nodes."""
    level, plan = np.divmod(faces, plan_count)
    ring = ring_of_node(grid.cap.core, grid.rings)[plan].max(axis=1)
    top, bottom = (level == layers).all(axis=1), (level == 0).all(axis=1)
    rim = Region.BOND if pad.rim == "bonded" else Region.SIDE
    regions = np.full(len(faces), int(rim), dtype=np.int32)
    regions[bottom] = Region.BOND
    regions[bottom & (ring <= (grid.cap.window_rings or grid.cap.cap_rings))] = Region.WINDOW
    regions[top] = Region.SIDE
    regions[top & (ring <= grid.cap.cap_rings)] = Region.CONTACT
    return regions
