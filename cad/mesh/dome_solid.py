# SPDX-License-Identifier: Apache-2.0
"""Structured tet meshes of solid domes, twice as fine at the surface as inside.

Straight columns lead from the lens pocket to the hemisphere and the wall, so that the ends of the
last ones lie on the flat base: the corner between base and wall is a corner of cells, and no cell
lies flat against the tangent between hemisphere and cylinder. The pocket is much smaller than the
surface, so the plan of the columns is halved on the way in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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
    even_cap_around,
    focused_cap,
    outside_outline_mm,
)
from taccel_lab.cad.mesh.refined_topology import RefinedTopology, level_of_node, refined_topology
from taccel_lab.cad.mesh.structured_plan import Focus
from taccel_lab.cad.mesh.structured_topology import ring_of_node
from taccel_lab.cad.parts.dome_pad import SolidDomePad
from taccel_lab.cad.parts.meridian import Piece
from taccel_lab.geometry import Region, TetMesh

_POCKET_WALL_SHARE = 0.5
"""Share of the wall's rings whose columns end on the pocket's wall."""
_POCKET_CAP_SHARE = 0.83
"""Share of the pocket's ceiling on which the columns of the cap end."""
_TALL = 1.5
"""Height of the coarse layers over the mean width of their cells, under the apex."""
_GROWTH_POWER = 1.8
"""Power of the ratio of cell widths at surface and pocket with which the layers grow."""
_BULGE = 0.8
"""How much taller the coarse layers half way down are for it."""
_TOP_LAYERS = (0.6, 0.5)
"""Heights of the layer between and of the fine ones over that of the uppermost coarse one."""
_BASE_LAYERS = (1.0, 0.7)
"""The same along the base, where the coarse layers are even."""
_POCKET_SAG = 0.0135
"""Sagitta of the chords round the pocket at an edge of 1 mm [mm]; it grows with its square."""


@dataclass(frozen=True)
class _Layers:
    """Layers below and above the one in which the plan is halved."""

    coarse: int
    fine: int
    growth: float = 1.0
    """Height of the uppermost coarse layer over the lowest, under the apex."""


def even_solid_mesh(pad: SolidDomePad, edge_mm: float = 1.0) -> TetMesh:
    """Mesh of ``pad`` whose cells on the contact face are about ``edge_mm`` large.

    All borders of regions are exact circles of nodes.
    """
    check_edge(edge_mm, pad.cap_radius_mm / 2)
    coarse = _even_grid(pad, edge_mm)
    fine = _doubled(coarse)
    disc = even_cap(fine.cap, pad.cap_angle, None)
    columns = dome_columns(fine, disc, pad.cap_angle, _wall_drops(pad, fine))
    layers = _even_layers(pad, coarse, edge_mm)
    inside = _on_pocket(pad, fine, columns)
    shares = _even_shares(pad, columns, layers)
    return _assemble(pad, coarse, fine, columns, inside, shares, layers)


def focused_solid_mesh(
    pad: SolidDomePad,
    focus: Focus,
    outlines: tuple[ContactOutline, ContactOutline] | None,
    *,
    core: int,
    rings: int,
    layers: int,
    layer_ratio: float,
) -> TetMesh:
    """Mesh of ``pad``, fine around a contact; the same connectivity wherever the contact is.

    ``core`` and ``rings`` count the fine plan; ``layers`` of it lie under the contact face, and
    as many of the coarse plan below.
    """
    whole = rings // 2
    bonded = 1 if pad.bonded_wall_mm else 0
    free = max(2, whole // 7)
    coarse = DomeGrid(CapGrid(core // 2, 0, whole), free, bonded)
    fine = _doubled(coarse)
    face, _ = outlines or (None, None)
    disc = focused_cap(fine.cap, pad.cap_angle, pad.dome_radius_mm, focus, face)
    drops = _wall_drops(pad, fine)
    columns = dome_columns(fine, disc, pad.cap_angle, drops)
    deep = even_cap_around(fine.cap, pad.cap_angle, pad.dome_radius_mm, focus)
    inside = _on_pocket(pad, fine, dome_columns(fine, deep, pad.cap_angle, drops))
    outside = columns.on_sphere_and_wall(pad.dome_radius_mm, -pad.dome_radius_mm)
    away = outside_outline_mm(disc, pad.cap_angle, pad.dome_radius_mm, focus, face)
    sizes = focused_sizes(fine, outside, away, pad.thickness_mm, layers, layer_ratio)
    counts = _Layers(coarse=layers + 1, fine=layers)
    length = np.linalg.norm(outside - inside, axis=1)
    shares = graded_shares(sizes, length, counts.coarse + 1 + counts.fine)
    return _assemble(pad, coarse, fine, columns, inside, shares, counts)


def _doubled(grid: DomeGrid) -> DomeGrid:
    """The fine plan over a coarse one."""
    cap = CapGrid(2 * grid.cap.core, 0, 2 * grid.cap.cap_rings)
    return DomeGrid(cap, 2 * grid.free_rings, 2 * grid.bonded_rings)


def _even_grid(pad: SolidDomePad, edge: float) -> DomeGrid:
    """Counts of the coarse plan for cells of about ``edge`` [mm] in the fine one."""
    outside = round(math.pi * pad.cap_radius_mm / (4 * edge))
    # Chords round the pocket add to those of its fillet, which one ring of nodes follows.
    pocket = math.ceil(math.pi / (4 * edge * math.sqrt(2 * _POCKET_SAG / pad.pocket_radius_mm)))
    core = int(np.clip(max(outside, pocket), 3, 32))
    arc = pad.dome_radius_mm * pad.cap_angle
    half = min(core * edge, LARGEST_CORE * arc)
    cap = CapGrid(core, 0, max(2, round((arc - half) / (2 * edge))))
    tall = 2 * edge
    bonded = pad.bonded_wall_mm
    return DomeGrid(
        cap,
        free_rings=max(2, round((pad.wall_height_mm - bonded) / tall)),
        bonded_rings=max(1, round(bonded / tall)) if bonded else 0,
    )


def _even_layers(pad: SolidDomePad, coarse: DomeGrid, edge: float) -> _Layers:
    """Layers about as tall as the coarse cells are wide on the way from pocket to surface."""
    below = 2 * math.pi * pad.pocket_radius_mm / (4 * coarse.cap.core)
    above = 2 * edge
    # The width changes evenly along a column, so the number of layers is the integral of 1 / width.
    ratio = above / below
    mean = (above - below) / math.log(ratio) if abs(ratio - 1) > 1e-6 else above
    count = max(3, round(pad.thickness_mm / (_TALL * mean)))
    return _Layers(coarse=count, fine=1, growth=ratio**_GROWTH_POWER)


def _wall_drops(pad: SolidDomePad, grid: DomeGrid) -> np.ndarray:
    """Distance of each wall ring below the cap's edge [mm], shape [free + bonded rings]."""
    free = pad.wall_height_mm - pad.bonded_wall_mm
    glued = free + even_drops(pad.bonded_wall_mm, grid.bonded_rings)
    return np.concatenate([even_drops(free, grid.free_rings), glued])


def _on_pocket(pad: SolidDomePad, grid: DomeGrid, columns: Columns) -> np.ndarray:
    """Points of the pocket under each column [mm], shape [n, 3].

    The column that ends in the middle of the fillet belongs to a ring of the wall; above it the
    columns stand on the ceiling, below it on the pocket's wall.
    """
    from scipy.interpolate import PchipInterpolator

    wall, fillet, ceiling = pad.meridian.of(Region.WINDOW)
    drops = _wall_drops(pad, grid)
    # An even number: the fillet belongs to a ring of the coarse plan.
    half = len(drops) // 2
    on_wall = 2 * int(np.clip(round(_POCKET_WALL_SHARE * half), 1, half - 1))
    middle = ceiling.length_mm + 0.5 * fillet.length_mm
    end = middle + 0.5 * fillet.length_mm + wall.length_mm
    arc = pad.dome_radius_mm * pad.cap_angle
    knots = np.array([0, arc, arc + drops[-1 - on_wall], arc + drops[-1]])
    on_pocket = PchipInterpolator(knots, [0, _POCKET_CAP_SHARE * ceiling.length_mm, middle, end])
    along = on_pocket(pad.dome_radius_mm * columns.theta + columns.drop_mm)
    rz = _chain_points((ceiling, fillet, wall), along)
    return np.stack(
        [rz[:, 0] * np.cos(columns.azimuth), rz[:, 0] * np.sin(columns.azimuth), rz[:, 1]], axis=-1
    )


def _chain_points(pieces: tuple[Piece, ...], along: np.ndarray) -> np.ndarray:
    """(r, z) at lengths along pieces walked backwards, from the axis out, [n] -> [n, 2]."""
    result = np.empty((len(along), 2))
    start = 0.0
    for k, piece in enumerate(pieces):
        end = start + piece.length_mm
        here = (along >= start) if k else np.ones(len(along), dtype=bool)
        result[here] = piece.point(1 - np.clip((along[here] - start) / piece.length_mm, 0, 1))
        start = end
    return result


def _assemble(
    pad: SolidDomePad,
    coarse: DomeGrid,
    fine: DomeGrid,
    columns: Columns,
    inside: np.ndarray,
    shares: np.ndarray,
    layers: _Layers,
) -> TetMesh:
    topology = refined_topology(coarse.cap.core, coarse.rings, layers.coarse, layers.fine)
    outside = columns.on_sphere_and_wall(pad.dome_radius_mm, -pad.dome_radius_mm)
    s = shares[..., None]
    levels = (1 - s) * inside + s * outside
    halved = levels[: layers.coarse + 1, topology.coarse_nodes].reshape(-1, 3)
    nodes = np.concatenate([halved, levels[layers.coarse + 1 :].reshape(-1, 3)])
    check_unfolded(nodes, topology.tets, remedy=FOLD_REMEDY)
    return TetMesh(
        nodes_m=nodes * 1e-3,
        tets=topology.tets.copy(),
        faces=topology.faces.copy(),
        face_regions=_regions(coarse, fine, topology, layers),
    )


def _even_shares(pad: SolidDomePad, columns: Columns, layers: _Layers) -> np.ndarray:
    """Height of each level over the pocket as a share of its column, shape [levels, n].

    Under the apex the layers grow from the pocket up, along the base they are even.
    """
    middle = np.sin(np.pi * (np.arange(layers.coarse) + 0.5) / layers.coarse)
    rise = layers.growth ** (np.arange(layers.coarse) / (layers.coarse - 1))
    grown = rise * (1 + _BULGE * middle)
    top = (grown[-1] * _TOP_LAYERS[0], grown[-1] * _TOP_LAYERS[1])
    axis = _stacked(grown, top, layers.fine)
    base = _stacked(np.ones(layers.coarse), _BASE_LAYERS, layers.fine)
    outside = pad.dome_radius_mm * columns.theta + columns.drop_mm
    f = outside / outside.max()
    thickness = (1 - f) * axis[:, None] + f * base[:, None]
    below = np.concatenate([np.zeros((1, len(f))), np.cumsum(thickness, axis=0)])
    below[-1] = 1.0
    return below


def _stacked(coarse: np.ndarray, top: tuple[float, float], fine: int) -> np.ndarray:
    """Heights of coarse layers, the one between and the fine ones, adding up to 1."""
    heights = np.concatenate([coarse, [top[0]], np.full(fine, top[1])])
    return heights / heights.sum()


def _regions(
    coarse: DomeGrid, fine: DomeGrid, topology: RefinedTopology, layers: _Layers
) -> np.ndarray:
    """Region of each face from the levels and rings of its nodes."""
    count = len(topology.coarse_nodes)
    level = level_of_node(count, topology.fine_count, layers.coarse, layers.fine)
    rings = np.concatenate([
        np.tile(2 * ring_of_node(coarse.cap.core, coarse.rings), layers.coarse + 1),
        np.tile(ring_of_node(fine.cap.core, fine.rings), layers.fine + 1),
    ])  # fmt: skip
    faces = topology.faces
    top = (level[faces] == level[-1]).all(axis=1)
    bottom = (level[faces] == 0).all(axis=1)
    ring = rings[faces].max(axis=1)
    regions = np.full(len(faces), int(Region.BOND), dtype=np.int32)
    regions[bottom] = Region.WINDOW
    regions[top & (ring <= fine.cap.cap_rings + fine.free_rings)] = Region.SIDE
    regions[top & (ring <= fine.cap.cap_rings)] = Region.CONTACT
    return regions
