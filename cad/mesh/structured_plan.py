# SPDX-License-Identifier: Apache-2.0
"""Where the nodes of the structured pad mesh lie in plan: evenly, or graded around a focus.

Both plans give the core nodes and the rings of ``structured_topology``; the outermost rings follow
the rim band, so that a chamfer or fillet keeps its edges whatever the focus is.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from cad.mesh.conformal import DiscMap, disc_automorphism, disc_map
from cad.mesh.o_grid import bulged_core, bulged_radius, ring_radii
from cad.mesh.plan_smoothing import smooth_plan
from cad.mesh.structured_topology import core_perimeter, plan_quads, ring_of_node
from cad.parts.gel_pad import GelPad

_ANGLE_WEIGHT = 0.6
_HELD_RINGS = 2
_BOUNDARY_DECAY = 3
_SEEN_WEIGHT = 0.8


@dataclass(frozen=True)
class Focus:
    """The disc in which a plan is fine: centre xy [mm], radius [mm] and element size [mm]."""

    center_mm: tuple[float, float]
    radius_mm: float
    size_mm: float


def rim_rings(pad: GelPad) -> int:
    """Rings that follow the rim band; it depends on the pad alone."""
    return {"none": 0, "chamfer": 2, "fillet": 3}[pad.rim]


def rim_distances_mm(pad: GelPad) -> np.ndarray:
    """Inside distance of each rim ring [mm], inner first, the outline (0) last; [] without rim."""
    if pad.rim == "chamfer":
        return pad.rim_mm * np.array([0.5, 0.0])
    if pad.rim == "fillet":
        return pad.rim_mm * np.array([0.5, 1 - np.sqrt(0.75), 0.0])
    return np.zeros(0)


def even_plan(pad: GelPad, core: int, rings: int, window_ring: int) -> np.ndarray:
    """Plan of about even spacing whose ring ``window_ring`` is the window's edge.

    Returns xy [mm], shape [(core + 1)^2 + 4 core rings, 2].
    """
    arc_of_corner = np.arange(4) * core
    outline, normals = _outline_nodes(pad, arc_of_corner, core, None)
    inner = outline - normals * pad.rim_setback_mm()
    t = np.linspace(-1, 1, core + 1)
    square = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1)
    window = square * np.array([pad.window_x_mm / 2, pad.window_y_mm / 2])
    # Cells of the core about as wide as the rings between it and the window.
    core_nodes = window * (core / (core + 2 * window_ring))
    edge, window_edge = (grid.reshape(-1, 2)[core_perimeter(core)] for grid in (core_nodes, window))
    band = rings - window_ring - rim_rings(pad)
    loops = [edge + (window_edge - edge) * k / window_ring for k in range(1, window_ring + 1)]
    loops += [window_edge + (inner - window_edge) * k / band for k in range(1, band + 1)]
    inside = np.concatenate([core_nodes.reshape(-1, 2), *loops])
    ring = ring_of_node(core, rings)[: len(inside)]
    loose = np.flatnonzero((ring != window_ring) & (ring != rings - rim_rings(pad)))
    inside = smooth_plan(inside, plan_quads(core, rings - rim_rings(pad)), loose)
    return np.concatenate([inside, *(outline - normals * d for d in rim_distances_mm(pad))])


def focus_plan(pad: GelPad, core: int, rings: int, focus: Focus) -> np.ndarray:
    """Plan graded around a focus: even rings inside it, growing ones from there to the outline.

    A polar grid of the unit disc, moved to the focus and mapped conformally onto the pad.
    Returns xy [mm], shape [(core + 1)^2 + 4 core rings, 2].
    """
    setback = pad.rim_setback_mm()
    chart = disc_map(
        pad.length_x_mm / 2 - setback, pad.length_y_mm / 2 - setback, pad.corner_radius_mm - setback
    )
    center = complex(chart.disc_from_plan(np.array(complex(*focus.center_mm))))
    slope = chart.slope_mm(center)
    per_mm = 1 / (abs(slope) * (1 - abs(center) ** 2))
    count = 4 * core
    corner_angles = _corner_angles(pad, chart, center, complex(*focus.center_mm), slope)
    step = 2 * np.pi / count
    # Turn the grid so that the corners of the outline are as near to nodes as they can be.
    turn = float(np.angle(np.exp(1j * corner_angles * count).mean())) / count
    theta = turn + step * (np.arange(count) - round((0.75 * np.pi + turn) / step))
    corners = _corner_indices(corner_angles, float(theta[0]), core, _half_arc_cells(pad, core))
    outline, normals = _outline_nodes(pad, corners, core, focus.center_mm)
    inner = outline - normals * setback
    boundary = np.angle(disc_automorphism(chart.disc_from_plan(inner @ [1, 1j]), -center))
    boundary = _unwrap_near(boundary, theta)

    free = rings - rim_rings(pad)
    # The core keeps the wanted cells, unless the outline is too near for them.
    half = min(core * focus.size_mm / 2 * per_mm, 0.3)
    size = 2 * half / core
    start = half * bulged_radius(theta - theta[0] - 0.75 * np.pi)
    wanted = round((focus.radius_mm * per_mm - half) / size)
    # At least half of the core's half width, so that the first ring clears the core's corners.
    even = int(np.clip(wanted, np.ceil(core / 4), max(1, free - 2)))
    rho = ring_radii(start, float(np.clip(half + even * size, 1.5 * half, 0.7)), even, free)
    angle = theta + rho**_BOUNDARY_DECAY * (boundary - theta)
    zeta = np.concatenate([
        half * np.exp(1j * (theta[0] + 0.75 * np.pi)) * (bulged_core(core) @ [1, 1j]).ravel(),
        (rho * np.exp(1j * angle)).ravel(),
    ])  # fmt: skip
    plan = chart.plan_from_disc(disc_automorphism(zeta, center))
    xy = np.stack([np.real(plan), np.imag(plan)], axis=-1)
    xy[-count:] = inner
    # Far from the focus the grid is skewed where the outline's corners pull at it.
    # The first rings outside the focus keep their even growth: a jump in size would show as a ring.
    held = even + min(_HELD_RINGS, free - even - 1)
    loose = np.arange((core + 1) ** 2 + count * held, len(xy) - count)
    xy = smooth_plan(xy, plan_quads(core, free), loose)
    return np.concatenate([xy, *(outline - normals * d for d in rim_distances_mm(pad))])


def _unwrap_near(angle: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Add full turns so that every angle is the one nearest to its reference."""
    return angle - 2 * np.pi * np.round((angle - reference) / (2 * np.pi))


def _half_arc_cells(pad: GelPad, core: int) -> int:
    """Cells on half a corner arc of the outline: at least one, and none longer than on the sides.

    It depends on the pad and the grid alone, so every focus gives the same connectivity.
    """
    r = pad.corner_radius_mm
    half_arc = 0.25 * np.pi * r
    outline = 2 * (pad.length_x_mm + pad.length_y_mm) - 8 * r + 8 * half_arc
    cells = round(4 * core * half_arc / outline)
    return int(np.clip(cells, 1 if core < 12 else 2, core // 2 - 1))


def _corner_angles(
    pad: GelPad, chart: DiscMap, center: complex, focus: complex, slope: complex
) -> np.ndarray:
    """Angle in the disc at which the grid should meet each outline corner, shape [4].

    Between the conformal angle, which leaves hardly a spoke to a far side, and the angle seen
    from the focus.
    """
    angle = chart.angle_of_corner()
    on_disc = np.exp(1j * np.array([np.pi + angle, -angle, angle, np.pi - angle]))
    conformal = np.angle(disc_automorphism(on_disc, -center))
    r = pad.corner_radius_mm * (1 - np.sqrt(0.5))
    x, y = pad.length_x_mm / 2 - r, pad.length_y_mm / 2 - r
    plan = np.array([complex(-x, -y), complex(x, -y), complex(x, y), complex(-x, y)])
    seen = _unwrap_near(np.angle((plan - focus) / slope), conformal)
    return (1 - _SEEN_WEIGHT) * conformal + _SEEN_WEIGHT * seen


def _corner_indices(
    corner_angles: np.ndarray, first_angle: float, core: int, arc_cells: int
) -> np.ndarray:
    """Ring index of the middle of each outline corner that turns the spokes least, shape [4].

    Every straight side keeps at least two cells.
    """
    count = 4 * core
    # Counter-clockwise from the first corner, whichever turn the angles were given in.
    turns = (corner_angles - corner_angles[0]) % (2 * np.pi)
    wanted = (corner_angles[0] + turns - first_angle) * count / (2 * np.pi)
    least = 2 * arc_cells + 2
    shifts = np.array(list(product((-3, -2, -1, 0, 1, 2, 3), repeat=4)))
    options = np.round(wanted).astype(int) + shifts
    gaps = np.diff(np.concatenate([options, options[:, :1] + count], axis=1), axis=1)
    cost = ((options - wanted) ** 2).sum(axis=1) + np.where(gaps.min(axis=1) < least, 1e6, 0)
    return options[int(np.argmin(cost))]


def _outline_nodes(
    pad: GelPad, corners: np.ndarray, core: int, center: tuple[float, float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes on the outline [mm] and their outward normals, each shape [4 core, 2].

    ``corners`` are the ring indices of the arc middles. On a straight side the nodes are spaced
    between equal lengths and, seen from ``center`` if given, equal angles.
    """
    count, m = 4 * core, _half_arc_cells(pad, core)
    r = pad.corner_radius_mm
    half = np.array([pad.length_x_mm, pad.length_y_mm]) / 2
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    points, normals = np.empty((count, 2)), np.empty((count, 2))
    arc = 0.25 * np.pi * np.arange(-m, m + 1) / m
    ends = []
    for k in range(4):
        a = -0.75 * np.pi + 0.5 * np.pi * k + arc
        normal = np.stack([np.cos(a), np.sin(a)], axis=-1)
        nodes = signs[k] * (half - r) + r * normal
        index = (corners[k] + np.arange(-m, m + 1)) % count
        points[index], normals[index] = nodes, normal
        ends.append((nodes[0], nodes[-1]))
    for k in range(4):
        first, last = ends[k][1], ends[(k + 1) % 4][0]
        begin = corners[k] + m
        cells = int(corners[(k + 1) % 4] - m + (count if k == 3 else 0) - begin)
        t = _side_spacing(first, last, cells, center)
        index = (begin + np.arange(1, cells)) % count
        points[index] = first + (last - first) * t[:, None]
        # Exactly one coordinate changes along a side, so its normal is an axis.
        normals[index] = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]], dtype=np.float64)[k]
    return points, normals


def _side_spacing(
    first: np.ndarray, last: np.ndarray, cells: int, center: tuple[float, float] | None
) -> np.ndarray:
    """Fractions along a straight side of its inner nodes, shape [cells - 1]."""
    even = np.arange(1, cells) / cells
    if center is None:
        return even
    along = last - first
    length = float(np.linalg.norm(along))
    unit = along / length
    foot = float((center - first) @ unit)
    distance = float(np.linalg.norm(first + foot * unit - center))
    a0, a1 = np.arctan2(-foot, distance), np.arctan2(length - foot, distance)
    seen = (foot + distance * np.tan(a0 + (a1 - a0) * even)) / length
    return _ANGLE_WEIGHT * seen + (1 - _ANGLE_WEIGHT) * even
