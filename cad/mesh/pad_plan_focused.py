# SPDX-License-Identifier: Apache-2.0
"""Where the nodes of a focused pad mesh lie in plan: graded around a place of contact.

The outermost rings follow a chamfer or fillet that rolls around the corners and the skin on the
wall, whatever the focus is.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from taccel_lab.cad.mesh.conformal import DiscMap, disc_automorphism, disc_map
from taccel_lab.cad.mesh.contact_plan import ContactOutline, EllipticMap, contact_plan
from taccel_lab.cad.mesh.focus import FocusOptions, graded_rings
from taccel_lab.cad.mesh.grid import plan_quads
from taccel_lab.cad.mesh.outline_nodes import outline_anchors
from taccel_lab.cad.mesh.plan_smoothing import smooth_plan
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad_outline import PadOutline

_ANGLE_WEIGHT = 0.6
_HELD_RINGS = 2
_BOUNDARY_DECAY = 3
_SEEN_WEIGHT = 0.8
_LARGEST_HALF = 0.18
"""Half width of the core in the disc at most, where the outline is near."""
_MAX_EVEN = 0.7
"""Share of the rings that may fill the focus; the others lead out to the outline."""
_SIDE_SAMPLES = 400


@dataclass(frozen=True)
class _Sight:
    """Direction in which things are seen from a focus."""

    center: complex
    around: EllipticMap | None

    def angle(self, xy: np.ndarray) -> np.ndarray:
        """Angles of points [mm], [n, 2]."""
        if self.around is None:
            return np.angle(xy @ [1, 1j] - self.center)
        return np.angle(self.around.forward(xy - [self.center.real, self.center.imag]))


def rim_distances_mm(pad: HeightPad) -> np.ndarray:
    """Distances of the rings inside the edge [mm]: inner first, the outline (0) last.

    The first is the border of the conformal grid. Arcs and bevels wider than the corner radius have
    no rings: their nodes lie on the formula, their edges between nodes.
    """
    distances = [0.0, pad.skin_side_mm]
    width = pad.rim_setback_mm()
    if pad.has_fillet:
        distances += [width, 0.5 * width, width * (1 - float(np.sqrt(0.75)))]
    elif isinstance(pad, GelPad) and pad.rim == "chamfer" and _rolls(pad):
        distances += [width, 0.5 * width]
    return np.unique(distances)[::-1]


def _rolls(pad: GelPad) -> bool:
    return not pad.has_band or pad.rim_mm <= 0.9 * pad.corner_radius_mm


def rim_rings(pad: HeightPad) -> int:
    """Rings outside the conformal grid; it depends on the kind of rim and skin alone."""
    return len(rim_distances_mm(pad)) - 1


def focus_plan(
    pad: HeightPad, focus: FocusOptions, outline: ContactOutline | None = None
) -> np.ndarray:
    """Plan graded around a focus: even rings inside it, growing ones from there to the outline.

    Nodes on the outline are spread as seen from the focus; with an ``outline`` of the contact as
    seen from the line between its foci, and the core's corners lie at odd multiples of 45 degrees
    and rings follow it, see ``contact_plan``.

    A polar grid of the unit disc, moved to the focus and mapped conformally onto the pad.
    Returns xy [mm], shape [(core + 1)^2 + 4 core rings, 2].
    """
    core, around = focus.core, None if outline is None else outline.round
    distances = rim_distances_mm(pad)
    setback = float(distances[0])
    border = pad.outline.inset(setback)
    chart = disc_map(border)
    center = complex(chart.disc_from_plan(np.array(complex(*focus.at_mm))))
    slope = chart.slope_mm(center)
    per_mm = 1 / (abs(slope) * (1 - abs(center) ** 2))
    count = 4 * core
    see = _Sight(complex(*focus.at_mm), around)
    corner_angles = _corner_angles(pad.outline, border, chart, center, see, slope)
    step = 2 * np.pi / count
    # Turn the grid so that the corners of the outline are as near to nodes as they can be.
    turn = float(np.angle(np.exp(1j * corner_angles * count).mean())) / count
    if around is not None:
        turn = -float(np.angle(slope))
    theta = turn + step * (np.arange(count) - round((0.75 * np.pi + turn) / step))
    half_arcs = _half_arcs(border, core)
    corners = _corner_indices(corner_angles, float(theta[0]), core, half_arcs)
    edge, normals = _outline_nodes(pad.outline, corners, half_arcs, core, see)
    inner = edge - normals * setback
    boundary = np.angle(disc_automorphism(chart.disc_from_plan(inner @ [1, 1j]), -center))
    boundary = _unwrap_near(boundary, theta)

    free = focus.rings - rim_rings(pad)
    square, rho, even = graded_rings(
        focus, free, per_mm, largest_half=_LARGEST_HALF,
        most_even=min(free - 2, round(_MAX_EVEN * free)),
    )  # fmt: skip
    angle = theta + rho**_BOUNDARY_DECAY * (boundary - theta)
    square = square * np.exp(1j * (theta[0] + 0.75 * np.pi))
    zeta = np.concatenate([square, (rho * np.exp(1j * angle)).ravel()])
    plan = chart.plan_from_disc(disc_automorphism(zeta, center))
    xy = np.stack([np.real(plan), np.imag(plan)], axis=-1)
    xy[-count:] = inner
    # Far from the focus the grid is skewed where the outline's corners pull at it.
    # The first rings outside the focus keep their even growth: a jump in size would show as a ring.
    held = even + min(_HELD_RINGS, free - even - 1)
    loose = np.arange((core + 1) ** 2 + count * held, len(xy) - count)
    xy = smooth_plan(xy, plan_quads(core, free), loose)
    xy = np.concatenate([xy, *(edge - normals * d for d in distances[1:])])
    if outline is None:
        return xy
    return contact_plan(xy, core, free, np.asarray(focus.at_mm), outline)


def _unwrap_near(angle: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Add full turns so that every angle is the one nearest to its reference."""
    return angle - 2 * np.pi * np.round((angle - reference) / (2 * np.pi))


def _half_arc_lengths_mm(outline: PadOutline) -> np.ndarray:
    """Length from each anchor to the end of its corner arc, 0 on arcs too long for corners, [4]."""
    starts = np.concatenate([[0.0], np.cumsum(outline.piece_lengths_mm)])
    at = outline_anchors(outline) % outline.perimeter_mm
    piece = np.searchsorted(starts, at, side="right") - 1
    turn = np.diff(outline.arc_angles, axis=1)[piece // 2, 0]
    return np.where(turn < 0.75 * np.pi, outline.piece_lengths_mm[piece] / 2, 0.0)


def _half_arcs(border: PadOutline, core: int) -> np.ndarray:
    """Cells on half of each corner arc, none longer than on the sides, shape [4].

    At least one, or two of a fine grid; fewer where the arc of the grid's border is so short that
    they would be slivers. They depend on the outline and the grid alone.
    """
    ratio = 4 * core * _half_arc_lengths_mm(border) / border.perimeter_mm
    least = np.where(ratio < 0.15, 0, np.where((ratio < 0.5) | (core < 12), 1, 2))
    return np.clip(np.round(ratio).astype(int), least, core // 2 - 1)


def _corner_angles(
    outline: PadOutline, border: PadOutline, chart: DiscMap, center: complex, see: _Sight,
    slope: complex,
) -> np.ndarray:  # fmt: skip
    """Angle in the disc at which the grid should meet each outline corner, shape [4].

    Between the conformal angle, which leaves hardly a spoke to a far side, and the angle seen
    from the focus.
    """
    inner = border.at_mm(outline_anchors(border))[0] @ [1, 1j]
    conformal = np.angle(disc_automorphism(chart.disc_from_plan(inner), -center))
    plan = outline.at_mm(outline_anchors(outline))[0]
    seen = _unwrap_near(see.angle(plan) - np.angle(slope), conformal)
    return (1 - _SEEN_WEIGHT) * conformal + _SEEN_WEIGHT * seen


def _corner_indices(
    corner_angles: np.ndarray, first_angle: float, core: int, half_arcs: np.ndarray
) -> np.ndarray:
    """Ring index of each outline corner that turns the spokes least, shape [4].

    Every straight side keeps at least two cells.
    """
    count = 4 * core
    # Counter-clockwise from the first corner, whichever turn the angles were given in.
    turns = (corner_angles - corner_angles[0]) % (2 * np.pi)
    wanted = (corner_angles[0] + turns - first_angle) * count / (2 * np.pi)
    least = half_arcs + np.roll(half_arcs, -1) + 2
    shifts = np.array(list(product((-3, -2, -1, 0, 1, 2, 3), repeat=4)))
    options = np.round(wanted).astype(int) + shifts
    gaps = np.diff(np.concatenate([options, options[:, :1] + count], axis=1), axis=1)
    short = (gaps < least).any(axis=1)
    cost = ((options - wanted) ** 2).sum(axis=1) + np.where(short, 1e6, 0)
    return options[int(np.argmin(cost))]


def _outline_nodes(
    outline: PadOutline, corners: np.ndarray, half_arcs: np.ndarray, core: int,
    see: _Sight,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Nodes on the outline [mm] and their outward normals, each shape [4 core, 2].

    ``corners`` are the ring indices of the anchors. Between corner arcs the nodes are spaced
    between equal lengths and, as seen, equal angles.
    """
    count = 4 * core
    anchors = outline_anchors(outline)
    ends = np.append(anchors, anchors[0] + outline.perimeter_mm)
    halves = np.where(half_arcs > 0, _half_arc_lengths_mm(outline), 0.0)
    halves = np.append(halves, halves[0])
    lengths = np.empty(count)
    for k in range(4):
        ahead, behind = half_arcs[k], half_arcs[(k + 1) % 4]
        begin, end = ends[k] + halves[k], ends[k + 1] - halves[k + 1]
        cells = int(corners[(k + 1) % 4] - corners[k] + (count if k == 3 else 0)) - ahead - behind
        middle = _spaced(outline, begin, end, cells, see)
        before = ends[k] + halves[k] * np.arange(ahead) / max(ahead, 1)
        after = end + halves[k + 1] * np.arange(1, behind) / max(behind, 1)
        found = np.concatenate([before, begin + (end - begin) * middle, [end], after])
        # The anchor that ends this side begins the next one.
        found = found[: cells + ahead + behind]
        lengths[(corners[k] + np.arange(len(found))) % count] = found
    return outline.at_mm(lengths)


def _spaced(outline: PadOutline, begin: float, end: float, cells: int, see: _Sight) -> np.ndarray:
    """Fractions of the length from ``begin`` to ``end`` of the first ``cells`` nodes there."""
    t = np.linspace(0, 1, _SIDE_SAMPLES + 1)
    angle = np.unwrap(see.angle(outline.at_mm(begin + (end - begin) * t)[0]))
    even = np.arange(cells) / cells
    seen = np.interp(angle[0] + (angle[-1] - angle[0]) * even, angle, t)
    return _ANGLE_WEIGHT * seen + (1 - _ANGLE_WEIGHT) * even
