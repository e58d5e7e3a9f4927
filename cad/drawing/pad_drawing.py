# SPDX-License-Identifier: Apache-2.0
"""The dimensioned drawing of a gel: plan, two sections, parameters, title block.

Third-angle projection about the plan, which looks at the touched face: section A-A (the plane
y = 0) below it, section B-B (x = 0) to its right, the touched face towards the plan in both. All
dimensions are measured on the solid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from build123d import GeomType, Vector

from taccel_lab.cad.drawing.sections import (
    DrawnSection,
    chain,
    circle_through,
    edge_points,
    plan_edges,
    section,
)
from taccel_lab.cad.drawing.sheet import THICK, THIN, DrawingSheet, Xy
from taccel_lab.cad.drawing.title import (
    SHEETS,
    TABLE_WIDTH_MM,
    Issue,
    TitleBlock,
    mm_words,
    sheet_and_scale,
    write_title,
)
from taccel_lab.cad.parts.part import LabelledSolid
from taccel_lab.cad.parts.solids import base_outline
from taccel_lab.geometry import Region

_LEFT, _ABOVE, _BETWEEN, _RIGHT, _BELOW = 34.0, 30.0, 30.0, 22.0, 20.0
_HATCHES = ("////", "\\\\\\\\", "xxxx")
_FILLS = ("#f6e3d0", "#d9d9de", "#e3eef2")
_ON_FACE_MM = 1e-3
_APEX_SHARE = 0.3
_SAME_CIRCLE = 0.01


@dataclass(frozen=True)
class _View:
    """Where a view stands on the sheet: sheet = origin + scale * (turned) part."""

    origin: Xy
    scale: float
    turned: bool = False
    """z to the left and y up, as in section B-B."""

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Part coordinates (u, v) to the sheet, [n, 2] -> [n, 2]."""
        uv = np.atleast_2d(np.asarray(points, dtype=float))
        xy = np.column_stack([-uv[:, 1], uv[:, 0]]) if self.turned else uv
        return np.array(self.origin) + self.scale * xy

    def at(self, u: float, v: float) -> Xy:
        """One point on the sheet."""
        x, y = self(np.array([[u, v]]))[0]
        return float(x), float(y)


def pad_drawing(
    gel: LabelledSolid,
    *,
    title: str,
    material: str = "silicone gel",
    parameters: Mapping[str, tuple[float | int | str, str]] | None = None,
    layers: Mapping[str, LabelledSolid] | None = None,
    faceted: str = "",
    issue: Issue | None = None,
) -> DrawingSheet:
    """The drawing of ``gel``.

    ``parameters`` are name -> (value, unit) for the table, named as ``--set`` takes them;
    ``layers`` by name are cut with a hatch each; ``faceted`` says how plane facets stand for the
    gel's faces: it becomes a note, and walls, which facets cut up, get no height.
    """
    box = gel.box
    size = np.array([box.size.X, box.size.Y, box.size.Z])
    name, scale = sheet_and_scale(lambda s: _needed(size, s), least=2.0)
    sheet = DrawingSheet(*SHEETS[name])
    # What is left of the sheet goes round the views in equal parts.
    room = np.array([sheet.width_mm - 16 - TABLE_WIDTH_MM, sheet.height_mm - 16])
    margin = (room - _needed(size, scale)) / 2
    plan = _View(
        (
            8 + margin[0] + _LEFT - scale * box.min.X,
            sheet.height_mm - 8 - margin[1] - _ABOVE - scale * box.max.Y,
        ),
        scale,
    )
    below = _View((plan.origin[0], plan.at(0, box.min.Y)[1] - _BETWEEN - scale * box.max.Z), scale)
    beside = _View(
        (plan.at(box.max.X, 0)[0] + _BETWEEN + scale * box.max.Z, plan.origin[1]), scale, True
    )
    bodies = list(layers.values()) if layers else [gel]
    _draw_plan(sheet, plan, gel)
    for view, along in ((below, "x"), (beside, "y")):
        cut = section(gel.solid, along)
        for k, body in enumerate(bodies):
            part = section(body.solid, along) if layers else cut
            for loops in part.faces:
                sheet.area(
                    [view(loop) for loop in loops], fill=_FILLS[k % 3], hatch=_HATCHES[k % 3]
                )
        _dimension_section(sheet, view, cut, gel, along, walls=not faceted)
    if layers:
        _dimension_layers(sheet, below, layers)
    _draw_cutting_lines(sheet, plan, box)
    write_title(
        sheet,
        TitleBlock(
            title=title, material=material, scale=scale, sheet=name,
            parameters=dict(parameters or {}), volume_mm3=gel.solid.volume,
            notes=(faceted,) if faceted else (), issue=issue,
        ),
    )  # fmt: skip
    return sheet


def _needed(size: np.ndarray, scale: float) -> np.ndarray:
    """Width and height of the three views with their dimensions on the sheet [mm]."""
    return np.array([
        scale * (size[0] + size[2]) + _LEFT + _BETWEEN + _RIGHT,
        scale * (size[1] + size[2]) + _ABOVE + _BETWEEN + _BELOW,
    ])  # fmt: skip


def _draw_plan(sheet: DrawingSheet, view: _View, gel: LabelledSolid) -> None:
    outline = base_outline(gel.solid, gel.box)
    sheet.area([view(chain(outline)[:, :2])], fill="white")
    upper = [*gel.faces(Region.CONTACT), *gel.faces(Region.SIDE)]
    for points in plan_edges([face for face in upper if face.center().Z > _low(gel)]):
        sheet.line(view(points), THIN)
    for points in plan_edges(gel.faces(Region.WINDOW)):
        sheet.line(view(points), THIN, "hidden")
    box = gel.box
    sheet.line(view(np.array([[box.min.X, 0], [box.max.X, 0]]) * 1.06), THIN / 1.5, "axis")
    sheet.line(view(np.array([[0, box.min.Y], [0, box.max.Y]]) * 1.06), THIN / 1.5, "axis")
    arcs = [e for e in outline.edges() if e.geom_type == GeomType.CIRCLE]
    whole = (
        sum(arc.length for arc in arcs) > 0.999 * outline.length
        and len({round(arc.radius, 3) for arc in arcs}) == 1
    )
    corner = (box.min.X, box.max.Y)
    if whole:
        sheet.dimension(
            view.at(box.min.X, 0), view.at(box.max.X, 0),
            view.scale * box.size.Y / 2 + 18, f"Ø{mm_words(box.size.X)}", along="x",
        )  # fmt: skip
    else:
        sheet.dimension(view.at(*corner), view.at(box.max.X, box.max.Y), 18, mm_words(box.size.X),
                        along="x")  # fmt: skip
        sheet.dimension(view.at(box.min.X, box.min.Y), view.at(*corner), 20, mm_words(box.size.Y),
                        along="y")  # fmt: skip
        _label_corners(sheet, view, arcs)
    _dimension_window(sheet, view, gel)


def _low(gel: LabelledSolid) -> float:
    return gel.box.min.Z + _ON_FACE_MM


def _label_corners(sheet: DrawingSheet, view: _View, arcs: Sequence) -> None:
    """One leader for each radius of the outline, at its lower right arc."""
    by_radius: dict[float, list] = {}
    for arc in arcs:
        by_radius.setdefault(round(arc.radius, 3), []).append(arc)
    for k, (radius, group) in enumerate(sorted(by_radius.items())):
        points = np.concatenate([edge_points(arc)[:, :2] for arc in group])
        # The lower right of the outline where there is an arc, else its upper right.
        drop = -1.0 if (points[:, 1] < 0).any() else 1.0
        at = points[int((points @ np.array([1.0, drop])).argmax())]
        count = f"{len(group)}× " if len(group) > 1 else ""
        point = view.at(at[0], at[1])
        elbow = (point[0] + 6 + 2 * k, point[1] + drop * (8 + 7 * k))
        sheet.leader(point, elbow, f"{count}R{mm_words(radius)}")


def _dimension_window(sheet: DrawingSheet, view: _View, gel: LabelledSolid) -> None:
    faces = gel.faces(Region.WINDOW)
    if not faces:
        return
    boxes = [face.bounding_box() for face in faces]
    low = (min(b.min.X for b in boxes), min(b.min.Y for b in boxes))
    high = (max(b.max.X for b in boxes), max(b.max.Y for b in boxes))
    box = gel.box
    round_window = any(e.geom_type == GeomType.CIRCLE for face in faces for e in face.edges())
    mark = "Ø" if round_window else ""
    level = (low[1] + high[1]) / 2 if round_window else high[1]
    to_top = view.scale * (box.max.Y - level)
    sheet.dimension(view.at(low[0], level), view.at(high[0], level), to_top + 8,
                    f"{mark}{mm_words(high[0] - low[0])} window", along="x")  # fmt: skip
    if not round_window:
        to_left = view.scale * (low[0] - box.min.X)
        sheet.dimension(view.at(low[0], low[1]), view.at(low[0], high[1]), to_left + 9,
                        f"{mm_words(high[1] - low[1])} window", along="y")  # fmt: skip


def _dimension_section(
    sheet: DrawingSheet,
    view: _View,
    cut: DrawnSection,
    gel: LabelledSolid,
    along: str,
    *,
    walls: bool,
) -> None:
    every = np.concatenate([loop for loops in cut.faces for loop in loops])
    low, high = every.min(axis=0), every.max(axis=0)
    letters = "A–A" if along == "x" else "B–B"
    contact = _contact_curve(cut, gel)
    if along == "x":
        label_at = (view.at(low[0], 0)[0] + 12, view.at(0, low[1])[1] - 14)
        _dimension_heights(sheet, view, cut, low, high, gel.box.size.Z)
        if walls:
            _dimension_wall(sheet, view, cut, low, high, "x")
    else:
        label_at = (view.at(0, (low[1] + high[1]) / 2)[0], view.at(high[0], 0)[1] + 14)
        if walls:
            _dimension_wall(sheet, view, cut, low, low, along)
    sheet.text(label_at, f"section {letters}", align="center", bold=True)
    _label_radii(sheet, view, cut, contact, along)


def _contact_curve(cut: DrawnSection, gel: LabelledSolid) -> np.ndarray:
    """Points of the section on the contact face, [n, 2]."""
    faces = gel.faces(Region.CONTACT)
    chosen = [
        edge.points
        for edge in cut.edges
        if min(face.distance_to(Vector(*edge.middle)) for face in faces) < _ON_FACE_MM
    ]
    return np.concatenate(chosen) if chosen else np.zeros((0, 2))


def _dimension_heights(
    sheet: DrawingSheet,
    view: _View,
    cut: DrawnSection,
    low: np.ndarray,
    high: np.ndarray,
    greatest: float,
) -> None:
    """Heights in section A-A; ``greatest`` is the body's, where that is not in the section."""
    total = high[1] - low[1]
    start = view.at(low[0], low[1])
    more = f" (max {mm_words(greatest)})" if greatest > total + 2e-3 else ""
    sheet.dimension(start, view.at(low[0], high[1]), 20, mm_words(total) + more, along="y")
    apex = _apex_thickness(cut)
    if apex is not None and apex < total - 1e-3:
        sheet.dimension(view.at(0, high[1] - apex), view.at(0, high[1]), view.scale * 0.12 *
                        float(high[0] - low[0]) + 2, f"{mm_words(apex)}", along="y")  # fmt: skip


def _dimension_layers(
    sheet: DrawingSheet, view: _View, layers: Mapping[str, LabelledSolid]
) -> None:
    """Thickness of the layers on the axis, and of an outer layer beside the inner one."""
    outlines = {name: section(layer.solid, "x") for name, layer in layers.items()}
    boxes = {
        name: np.concatenate([loop for loops in cut.faces for loop in loops])
        for name, cut in outlines.items()
    }
    left = min(float(points[:, 0].min()) for points in boxes.values())
    low = min(float(points[:, 1].min()) for points in boxes.values())
    right = max(float(points[:, 0].max()) for points in boxes.values())
    for k, (name, cut) in enumerate(outlines.items()):
        span = _span_on_axis(cut)
        if span is not None:
            words = f"{mm_words(span[1] - span[0])} {name}"
            feet = view.at(right, span[0]), view.at(right, span[1])
            sheet.dimension(*feet, -8 - 9 * k, words, along="y")
    inner = min(boxes, key=lambda name: float(np.ptp(boxes[name][:, 0])))
    start = float(boxes[inner][:, 0].min())
    outer = next((name for name in boxes if name != inner), "")
    if start - left > _ON_FACE_MM:
        sheet.dimension(view.at(left, low), view.at(start, low), -7,
                        f"{mm_words(start - left)} {outer}", along="x")  # fmt: skip


def _dimension_wall(
    sheet: DrawingSheet,
    view: _View,
    cut: DrawnSection,
    low: np.ndarray,
    end: np.ndarray,
    along: str,
) -> None:
    """Height of the upright wall at one end of the section, unless it is all of the height."""
    every = np.concatenate([edge.points for edge in cut.edges])
    wall = sum(
        float(np.ptp(edge.points[:, 1]))
        for edge in cut.edges
        if np.ptp(edge.points[:, 0]) < 1e-4 and abs(edge.points[0, 0] - end[0]) < _ON_FACE_MM
    )
    if not 0.02 < wall < np.ptp(every[:, 1]) - 1e-3:
        return
    foot, top = view.at(end[0], low[1]), view.at(end[0], low[1] + wall)
    if along == "x":
        sheet.dimension(foot, top, -9, f"{mm_words(wall)} wall", along="y")
    else:
        sheet.dimension(top, foot, -9, f"{mm_words(wall)} wall", along="x")


def _apex_thickness(cut: DrawnSection) -> float | None:
    """Height of material under the highest point of the axis [mm]."""
    span = _span_on_axis(cut)
    return None if span is None else span[1] - span[0]


def _span_on_axis(cut: DrawnSection) -> tuple[float, float] | None:
    """Lowest and highest v of the uppermost material on the axis u = 0 [mm]."""
    crossings = []
    for loops in cut.faces:
        for loop in loops:
            a, b = loop, np.roll(loop, -1, axis=0)
            hit = (a[:, 0] > 1e-9) != (b[:, 0] > 1e-9)
            t = (1e-9 - a[hit, 0]) / (b[hit, 0] - a[hit, 0])
            crossings += (a[hit, 1] + t * (b[hit, 1] - a[hit, 1])).tolist()
    crossings.sort(reverse=True)
    return (crossings[1], crossings[0]) if len(crossings) > 1 else None


def _label_radii(
    sheet: DrawingSheet, view: _View, cut: DrawnSection, contact: np.ndarray, along: str
) -> None:
    """Radius of the contact face at the apex, outside, and of all other arcs, from behind."""
    if len(contact):
        half = np.abs(contact[:, 0]).max()
        radius = circle_through(_near_apex(contact, _APEX_SHARE * half))
        if np.isfinite(radius):
            place = contact[int(np.abs(contact[:, 0] - 0.25 * half).argmin())]
            point = view.at(float(place[0]), float(place[1]))
            shift = (-5.0, 8.0) if along == "x" else (-6.0, 8.0)
            whole = circle_through(_near_apex(contact, 0.8 * half))
            local = "" if abs(whole / radius - 1) < _SAME_CIRCLE else "\nat apex"
            words = f"R{mm_words(round(radius, 2))}{local}"
            sheet.leader(point, (point[0] + shift[0], point[1] + shift[1]), words)
    back = min(float(edge.points[:, 1].min()) for edge in cut.edges)
    seen: set[float] = set()
    for edge in cut.edges:
        radius = round(edge.radius_mm, 3)
        middle = edge.points[len(edge.points) // 2]
        on_contact = len(contact) and np.linalg.norm(contact - middle, axis=1).min() < 0.2
        # Arcs of the rim on the left, where no wall is dimensioned; all others on the right.
        wrong_side = middle[0] > 1e-6 if on_contact else middle[0] < -1e-6
        if not radius or radius in seen or (on_contact and radius > 3) or wrong_side:
            continue
        point, base = view.at(float(middle[0]), float(middle[1])), view.at(0, back)
        far = 6.0 + 7.0 * len(seen)
        if on_contact:
            elbow = (point[0] - 6, point[1] + (6 if along == "x" else -8))
        elif along == "x":
            elbow = (max(point[0] + 6, base[0] + 6), base[1] - far)
        else:
            elbow = (base[0] + 6, point[1] + far)
        seen.add(radius)
        sheet.leader(point, elbow, f"R{mm_words(radius)}")


def _near_apex(contact: np.ndarray, reach: float) -> np.ndarray:
    """Points of the contact curve within ``reach`` of the apex, also where it is one line."""
    near = contact[np.abs(contact[:, 0]) <= reach]
    if len(near) > 20:
        return near
    ordered = contact[contact[:, 0].argsort()]
    u = np.linspace(-reach, reach, 41)
    return np.column_stack([u, np.interp(u, ordered[:, 0], ordered[:, 1])])


def _draw_cutting_lines(sheet: DrawingSheet, view: _View, box) -> None:
    """Letters at the ends of the two planes of section."""
    reach = 5.0
    for letter, ends in (
        ("A", (view.at(box.min.X, 0), view.at(box.max.X, 0))),
        ("B", (view.at(0, box.min.Y), view.at(0, box.max.Y))),
    ):
        for (x, y), sign in zip(ends, (-1, 1), strict=True):
            if letter == "A":
                sheet.line([(x + sign * 1.5, y), (x + sign * (reach + 1), y)], THICK)
                sheet.text((x + sign * (reach - 1), y + 3), letter, align="center", bold=True)
            else:
                sheet.line([(x, y + sign * 1.5), (x, y + sign * (reach + 1))], THICK)
                sheet.text((x + 3, y + sign * (reach - 1)), letter, align="center", bold=True)
