# SPDX-License-Identifier: Apache-2.0
"""Structured meshes of domes, even or fine around a contact.

The plan is an O-grid on the cap that goes on down the wall; columns lead from the inside, the hard
core of a shell or the lens pocket of a solid dome, out to cap and wall. Columns of a solid dome are
straight, so that the ends of the last ones lie on the flat base: the corner between base and wall
is a corner of cells, and no cell lies flat against the tangent between hemisphere and cylinder. Its
pocket is much smaller than its surface, so its plan is halved on the way in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.cad.mesh.dome_plan import (
    LARGEST_CORE,
    DomeCounts,
    angle_from_disc,
    even_cap,
    even_cap_around,
    focused_cap,
    outside_outline_mm,
)
from taccel_lab.cad.mesh.focus import MIN_FOCUS_EDGE_MM, FocusOptions
from taccel_lab.cad.mesh.grid import grid_of, plan_quads
from taccel_lab.cad.mesh.template import (
    Template,
    check_unfolded,
    columns_mm,
    level_fractions,
)
from taccel_lab.cad.mesh.tet_smoothing import improve_worst_tets
from taccel_lab.cad.parts.dome_pad import ShellDomePad, SolidDomePad
from taccel_lab.cad.parts.meridian import Piece
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.guards import require_range

Dome = ShellDomePad | SolidDomePad
"""Domes that have a structured mesh."""
EVEN_DEG, FOCUSED_DEG = 11.5, 3.0
"""Tets with a smaller dihedral angle are smoothed [deg]; cells far from a contact may be flat."""
_POWERS = (4, 8, 16, 16, 16)
_EDGE_BOUNDS_MM = (0.2, 6.0)
_SATURATION = 2.0
"""Tallest layer of a graded column over its mean one."""
_SPREAD = 8.0
"""Thickness of a shell over the size of the cells under a contact at the core."""
_LEAN = 0.5
"""How far a shell's columns at the edge of the fine part may lean outward, over the thickness."""
_POCKET_WALL_SHARE = 0.5
"""Share of the wall's rings whose columns end on the pocket's wall."""
_POCKET_CAP_SHARE = 0.83
"""Share of the pocket's ceiling on which the columns of the cap end."""
_TALL = 1.5
"""Height of the halved layers over the mean width of their cells, under the apex."""
_GROWTH_POWER = 1.8
"""Power of the ratio of cell widths at surface and pocket with which the layers grow."""
_BULGE = 0.8
"""How much taller the halved layers half way down are for it."""
_TOP_LAYERS = (0.6, 0.5)
"""Heights of the layer that leads over and of the one above over the uppermost halved one."""
_BASE_LAYERS = (1.0, 0.7)
"""The same along the base, where the halved layers are even."""
_POCKET_SAG = 0.0135
"""Sagitta of the chords round the pocket at an edge of 1 mm [mm]; it grows with its square."""


@dataclass(frozen=True)
class _Columns:
    """The outer ends of the columns, one for each plan node."""

    theta: np.ndarray
    """Polar angle on the cap [rad], the cap's for nodes on the wall."""
    azimuth: np.ndarray
    drop_mm: np.ndarray
    """Distance below the cap's edge along the wall [mm]."""

    def on_sphere_and_wall(self, radius_mm: float, center_z_mm: float) -> np.ndarray:
        """Points on the cap and wall of a radius about (0, 0, center_z_mm) [mm], shape [n, 3]."""
        ring = radius_mm * np.sin(self.theta)
        return np.stack(
            [
                ring * np.cos(self.azimuth),
                ring * np.sin(self.azimuth),
                radius_mm * np.cos(self.theta) + center_z_mm - self.drop_mm,
            ],
            axis=-1,
        )


def even_dome_mesh(pad: Dome, edge_mm: float) -> TetMesh:
    """Mesh whose cells on the contact face are about ``edge_mm`` large; see ``gel_mesh``.

    All borders of regions are exact circles of nodes.
    """
    low, high = _EDGE_BOUNDS_MM
    require_range("edge_mm", edge_mm, low, min(high, pad.cap_radius_mm / 2))
    if isinstance(pad, ShellDomePad):
        counts = _even_shell_counts(pad, edge_mm)
        window_angle = pad.window_angle if pad.window_deg else None
        columns = _columns(pad, counts, even_cap(counts, pad.cap_angle, window_angle))
        shares = np.linspace(0, 1, counts.layers + 1)[:, None]
    else:
        counts, growth = _even_solid_counts(pad, edge_mm)
        columns = _columns(pad, counts, even_cap(counts, pad.cap_angle, None))
        shares = _even_solid_shares(pad, columns, counts, growth)
    levels = columns_mm(_inside_mm(pad, counts, columns), _outside_mm(pad, columns), shares)
    return _meshed(pad, counts, levels, EVEN_DEG)


def focused_dome_mesh(pad: Dome, focus: FocusOptions) -> TetMesh:
    """Mesh that is fine around a contact; see ``focused_gel_mesh``.

    Layers grow from the uppermost by the focus's ratio or more. A solid dome has as many layers of
    the halved plan as of the whole one; core and rings are then even. The border of a window
    follows the rings and is only approximate: both sides of it are glued.
    """
    _check_focus(pad, focus)
    face, back = focus.outlines or (None, None)
    if isinstance(pad, ShellDomePad):
        counts = _focused_shell_counts(pad, focus)
        # Wider cells at the core, as far as the thickness asks for: tall thin tets are flat ones.
        wide = min(
            max(1.0, pad.thickness_mm / (_SPREAD * focus.size_mm)),
            1 + _LEAN * pad.thickness_mm / focus.radius_mm,
        )
        deep = replace(focus, radius_mm=wide * focus.radius_mm, size_mm=wide * focus.size_mm)
        below = focused_cap(counts, pad, deep, back)
    else:
        counts = _focused_solid_counts(pad, focus)
        below = even_cap_around(counts, pad, focus)
    disc = focused_cap(counts, pad, focus, face)
    outside = _outside_mm(pad, _columns(pad, counts, disc))
    inside = _inside_mm(pad, counts, _columns(pad, counts, below))
    sizes = _cell_widths(outside, plan_quads(counts.core, counts.rings))
    if face is not None:
        # Under an outline the uppermost layer is that of the focus; it goes over to the width of
        # the cells as far away as the gel is thick.
        far = np.ones(len(sizes))
        away = outside_outline_mm(disc, pad, focus, face)
        far[: len(away)] = np.clip(away / pad.thickness_mm, 0, 1)
        ratio = np.array(focus.layer_ratio)
        uppermost = float(1 - level_fractions(focus.layers, ratio)[-2]) * pad.thickness_mm
        sizes = (1 - far) * uppermost + far * sizes
    length = np.linalg.norm(outside - inside, axis=1)
    if isinstance(pad, ShellDomePad):
        length = np.full(len(sizes), pad.thickness_mm)
    shares = graded_shares(sizes, length, counts.layers)
    return _meshed(pad, counts, columns_mm(inside, outside, shares), FOCUSED_DEG)


def _meshed(pad: Dome, counts: DomeCounts, levels: np.ndarray, wanted_deg: float) -> TetMesh:
    """The mesh with inner nodes moved where tets are flatter than wanted; the surface stays."""
    grid = grid_of(counts.core, counts.rings, counts.layers, halved_layers=counts.halved_layers)
    glued_rim = isinstance(pad, SolidDomePad) or pad.rim == "bonded"
    whole = counts.rings if isinstance(pad, SolidDomePad) else counts.cap_rings
    template = Template(
        grid,
        wall=Region.BOND if glued_rim else Region.SIDE,
        contact_rings=counts.cap_rings,
        free_rings=counts.free_rings,
        window_rings=counts.window_rings or whole,
    )
    nodes = template.nodes_mm(levels)
    check_unfolded(nodes, grid.tets)
    inner = np.setdiff1d(np.arange(len(nodes)), grid.faces)
    nodes = improve_worst_tets(nodes, grid.tets, inner, wanted_deg=wanted_deg, powers=_POWERS)
    return template.mesh(nodes)


def graded_shares(size_mm: np.ndarray, length_mm: np.ndarray, layers: int) -> np.ndarray:
    """Height of each level as a share of its column, 0 to 1, shape [layers + 1, n].

    The uppermost layer of each column is about as thick as its cell is wide, ``size_mm`` [n]. The
    layers below grow by one factor until they saturate, so that they fill ``length_mm`` [n] without
    a tall one at the end; short columns get even layers.
    """
    powers = np.arange(layers)[:, None]
    tallest = _SATURATION * length_mm / layers

    def thickness(growth: np.ndarray) -> np.ndarray:
        grown = size_mm * growth**powers
        return grown * tallest / (grown + tallest)

    low, high = np.ones(len(size_mm)), np.full(len(size_mm), 8.0)
    for _ in range(50):
        growth = 0.5 * (low + high)
        short = thickness(growth).sum(axis=0) < length_mm
        low, high = np.where(short, growth, low), np.where(short, high, growth)
    below = np.concatenate([np.zeros((1, len(low))), np.cumsum(thickness(low)[::-1], axis=0)])
    shares = below / below[-1]
    shares[-1] = 1.0
    return shares


def _check_focus(pad: Dome, focus: FocusOptions) -> None:
    if focus.rings % 2:
        raise InputError(f"rings = {focus.rings} is odd; domes need an even number")
    away = float(np.hypot(*focus.at_mm))
    if away > pad.cap_radius_mm or pad.arc_to_edge_mm(np.array(focus.at_mm)) < MIN_FOCUS_EDGE_MM:
        reach = pad.dome_radius_mm * math.sin(
            pad.cap_angle - MIN_FOCUS_EDGE_MM / pad.dome_radius_mm
        )
        raise InputError(
            f"at_mm = ({focus.at_mm[0]:g}, {focus.at_mm[1]:g}) lies {away:.3f} mm from the axis; "
            f"allowed: up to {reach:.3f} mm, {MIN_FOCUS_EDGE_MM:g} mm inside the edge of the "
            "contact face"
        )
    focus.check_size(pad.cap_radius_mm)


# Counts ---------------------------------------------------------------------------------------


def _even_shell_counts(pad: ShellDomePad, edge: float) -> DomeCounts:
    """Counts for about even cells of size ``edge`` [mm] on the contact face."""
    radius = pad.dome_radius_mm
    core = int(np.clip(2 * round(math.pi * pad.cap_radius_mm / (4 * edge)), 4, 64))
    arc, seen = radius * pad.cap_angle, radius * pad.window_angle
    half = min(0.5 * core * edge, LARGEST_CORE * seen)
    inner = max(2, round((seen - half) / edge))
    outer = max(1, round((arc - seen) / edge)) if pad.window_deg else 0
    return DomeCounts(
        core,
        window_rings=inner if outer else 0,
        cap_rings=inner + outer,
        free_rings=max(1, round(pad.skirt_mm / edge)) if pad.skirt_mm else 0,
        bonded_rings=0,
        layers=max(1 if pad.thickness_mm < 0.5 * edge else 2, round(pad.thickness_mm / edge)),
    )


def _focused_shell_counts(pad: ShellDomePad, focus: FocusOptions) -> DomeCounts:
    share = pad.window_angle / pad.cap_angle
    window = int(np.clip(round(share * focus.rings), 1, focus.rings - 1)) if pad.window_deg else 0
    skirt = max(2, focus.rings // 5) if pad.skirt_mm else 0
    return DomeCounts(focus.core, window, focus.rings, skirt, 0, focus.layers)


def _even_solid_counts(pad: SolidDomePad, edge: float) -> tuple[DomeCounts, float]:
    """Counts for cells of about ``edge`` [mm] on the contact face, and the height of the uppermost
    halved layer over the lowest, under the apex: layers are about as tall as the halved cells are
    wide on the way from pocket to surface.
    """
    outside = round(math.pi * pad.cap_radius_mm / (4 * edge))
    # Chords round the pocket add to those of its fillet, which one ring of nodes follows.
    pocket = math.ceil(math.pi / (4 * edge * math.sqrt(2 * _POCKET_SAG / pad.pocket_radius_mm)))
    core = int(np.clip(max(outside, pocket), 3, 32))
    arc = pad.dome_radius_mm * pad.cap_angle
    half = min(core * edge, LARGEST_CORE * arc)
    bonded = pad.bonded_wall_mm
    below, above = 2 * math.pi * pad.pocket_radius_mm / (4 * core), 2 * edge
    # The width changes evenly along a column, so the number of layers is the integral of 1 / width.
    ratio = above / below
    mean = (above - below) / math.log(ratio) if abs(ratio - 1) > 1e-6 else above
    halved = max(3, round(pad.thickness_mm / (_TALL * mean)))
    counts = DomeCounts(
        core=2 * core,
        window_rings=0,
        cap_rings=2 * max(2, round((arc - half) / (2 * edge))),
        free_rings=2 * max(2, round((pad.wall_height_mm - bonded) / (2 * edge))),
        bonded_rings=2 * max(1, round(bonded / (2 * edge))) if bonded else 0,
        layers=halved + 2,
        halved_layers=halved,
    )
    return counts, ratio**_GROWTH_POWER


def _focused_solid_counts(pad: SolidDomePad, focus: FocusOptions) -> DomeCounts:
    return DomeCounts(
        focus.core,
        window_rings=0,
        cap_rings=focus.rings,
        free_rings=2 * max(2, focus.rings // 14),
        bonded_rings=2 if pad.bonded_wall_mm else 0,
        layers=2 * (focus.layers + 1),
        halved_layers=focus.layers + 1,
    )


# Columns --------------------------------------------------------------------------------------


def _columns(pad: Dome, counts: DomeCounts, disc: np.ndarray) -> _Columns:
    """Columns through ``disc`` points of the cap, the last ring on its edge, and the wall's."""
    drops, spokes = _wall_drops(pad, counts), 4 * counts.core
    theta = angle_from_disc(np.abs(disc), pad.cap_angle)
    theta[-spokes:] = pad.cap_angle
    azimuth = np.angle(disc)
    return _Columns(
        theta=np.concatenate([theta, np.full(len(drops) * spokes, pad.cap_angle)]),
        azimuth=np.concatenate([azimuth, np.tile(azimuth[-spokes:], len(drops))]),
        drop_mm=np.concatenate([np.zeros(len(disc)), np.repeat(drops, spokes)]),
    )


def _wall_drops(pad: Dome, counts: DomeCounts) -> np.ndarray:
    """Distance of each wall ring below the cap's edge [mm], shape [free + bonded rings]."""
    if isinstance(pad, ShellDomePad):
        free, glued = pad.skirt_mm, 0.0
    else:
        free, glued = pad.wall_height_mm - pad.bonded_wall_mm, pad.bonded_wall_mm
    above = free * np.arange(1, counts.free_rings + 1) / max(counts.free_rings, 1)
    below = glued * np.arange(1, counts.bonded_rings + 1) / max(counts.bonded_rings, 1)
    return np.concatenate([above, free + below])


def _outside_mm(pad: Dome, columns: _Columns) -> np.ndarray:
    return columns.on_sphere_and_wall(pad.dome_radius_mm, -pad.dome_radius_mm)


def _inside_mm(pad: Dome, counts: DomeCounts, columns: _Columns) -> np.ndarray:
    """Where columns begin: on the core of a shell or in the pocket [mm], shape [n, 3]."""
    if isinstance(pad, ShellDomePad):
        return columns.on_sphere_and_wall(pad.core_radius_mm, -pad.dome_radius_mm)
    return _on_pocket(pad, counts, columns)


def _on_pocket(pad: SolidDomePad, counts: DomeCounts, columns: _Columns) -> np.ndarray:
    """Points of the pocket under each column [mm], shape [n, 3].

    The column that ends in the middle of the fillet belongs to a ring of the wall; above it the
    columns stand on the ceiling, below it on the pocket's wall.
    """
    from scipy.interpolate import PchipInterpolator

    wall, fillet, ceiling = pad.meridian.of(Region.WINDOW)
    drops = _wall_drops(pad, counts)
    # An even number: the fillet belongs to a ring of the halved plan.
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


def _even_solid_shares(
    pad: SolidDomePad, columns: _Columns, counts: DomeCounts, growth: float
) -> np.ndarray:
    """Height of each level over the pocket as a share of its column, shape [levels, n].

    Under the apex the layers grow from the pocket up by ``growth``, along the base they are even.
    """
    halved = counts.halved_layers
    middle = np.sin(np.pi * (np.arange(halved) + 0.5) / halved)
    rise = growth ** (np.arange(halved) / (halved - 1))
    grown = rise * (1 + _BULGE * middle)
    axis = np.concatenate([grown, grown[-1] * np.array(_TOP_LAYERS)])
    base = np.concatenate([np.ones(halved), _BASE_LAYERS])
    outside = pad.dome_radius_mm * columns.theta + columns.drop_mm
    f = outside / outside.max()
    thickness = (1 - f) * (axis / axis.sum())[:, None] + f * (base / base.sum())[:, None]
    below = np.concatenate([np.zeros((1, len(f))), np.cumsum(thickness, axis=0)])
    below[-1] = 1.0
    return below


def _cell_widths(points_mm: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Mean length of the edges at each node of a surface [mm], [n, 3] and [m, 4] -> [n]."""
    total, count = np.zeros(len(points_mm)), np.zeros(len(points_mm))
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
        length = np.linalg.norm(points_mm[quads[:, a]] - points_mm[quads[:, b]], axis=1)
        for end in (quads[:, a], quads[:, b]):
            total += np.bincount(end, length, len(total))
            count += np.bincount(end, minlength=len(total))
    return total / count
