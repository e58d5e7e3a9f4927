# SPDX-License-Identifier: Apache-2.0
"""An assembly: section y = 0 with numbered parts, plan with lights and camera, list of parts.

Parts that overlap are drawn red in both views and named in a note.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import to_hex

from taccel_lab.cad.assembly import Assembly, PartClearance, overlapping, require_no_overlap
from taccel_lab.cad.drawing.sections import DrawnSection, plan_edges, section
from taccel_lab.cad.drawing.sheet import THICK, THIN, DrawingSheet, Xy
from taccel_lab.cad.drawing.title import (
    PART_TOLERANCES,
    SHEETS,
    TABLE_WIDTH_MM,
    Issue,
    TitleBlock,
    mm_words,
    sheet_and_scale,
    write_title,
)
from taccel_lab.cad.parts.part import Part

_HATCHES = ("////", "\\\\\\\\", "", "xx", "..", "//", "\\\\")
_MARGINS = np.array([84.0, 62.0])
_BALLOON_MM = 9.0
_RED = "#c1121f"


def assembly_drawing(
    assembly: Assembly,
    *,
    title: str,
    notes: Sequence[str] = (),
    issue: Issue | None = None,
) -> DrawingSheet:
    """The drawing of ``assembly``: section y = 0 (z up) and plan (y up).

    Parts that the plane misses are listed without a number in the section; the plan shows all
    lights. Raises InputError when made parts interpenetrate.
    """
    clearances = assembly.clearances()
    overlaps = require_no_overlap(clearances)
    clashing = {name for c in overlapping(clearances) for name in (c.first, c.second)}
    cuts = [(part, section(part.solid, "x")) for part in assembly.parts]
    every = np.concatenate([loop for _, cut in cuts for loops in cut.faces for loop in loops])
    low, high = every.min(axis=0), every.max(axis=0)
    outlines = [_outline(part) for part in assembly.parts]
    plan_low = np.min([outline.min(axis=0) for outline in outlines], axis=0)
    plan_high = np.max([outline.max(axis=0) for outline in outlines], axis=0)
    depth = float(plan_high[1] - plan_low[1])
    wide = max(high[0], plan_high[0]) - min(low[0], plan_low[0])
    size = np.array([wide, high[1] - low[1] + depth])
    name, scale = sheet_and_scale(lambda s: s * size + _MARGINS, least=1.5)
    sheet = DrawingSheet(*SHEETS[name])
    room = np.array([sheet.width_mm - 16 - TABLE_WIDTH_MM, sheet.height_mm - 16])
    spare = (room - scale * size - _MARGINS)[1] / 2
    middle = 8 + room[0] / 2 - scale * (low[0] + high[0]) / 2
    origin = np.array([middle, 8 + spare + 24 - scale * low[1]])
    plan = np.array([middle, origin[1] + scale * (high[1] - plan_low[1]) + 22])

    def at(u: float, v: float) -> Xy:
        return float(origin[0] + scale * u), float(origin[1] + scale * v)

    for k, (part, cut) in enumerate(cuts):
        for loops in cut.faces:
            sheet.area(
                [origin + scale * loop for loop in loops], fill=_fill(part), width=THIN * 1.4,
                hatch="" if part.placeholder else _HATCHES[k % len(_HATCHES)],
            )  # fmt: skip
    for part, cut in cuts:
        if part.name in clashing and part.placeholder:
            for loops in cut.faces:
                places = [origin + scale * loop for loop in loops]
                sheet.area(places, fill=_fill(part), width=THICK, edge=_RED)
    sheet.line([at(0, low[1] - 2 / scale), at(0, high[1] + 4 / scale)], THIN / 1.5, "axis")
    sheet.dimension(at(low[0], low[1]), at(high[0], low[1]), -12,
                    mm_words(high[0] - low[0]), along="x")  # fmt: skip
    sheet.dimension(at(low[0], low[1]), at(low[0], high[1]), 14,
                    mm_words(high[1] - low[1]), along="y")  # fmt: skip
    _balloons(sheet, cuts, at, high, scale)
    sheet.text((at(float(low[0]), 0)[0], at(0, float(high[1]))[1] + 7), "section y = 0", bold=True)
    _draw_plan(sheet, assembly, [plan + scale * outline for outline in outlines], clashing)
    write_title(
        sheet,
        TitleBlock(
            title=title, material="see the list of parts", scale=scale, sheet=name,
            notes=(*overlaps, *_gap_notes(clearances), *notes), what="assembly",
            volume_mm3=sum(p.solid.volume for p in assembly.parts if not p.placeholder),
            heading=("part", "volume", "mm³"), tolerances=PART_TOLERANCES, issue=issue,
            parameters={
                f"{k + 1} {part.name} ({part.material})": (round(part.solid.volume, 1), "")
                for k, part in enumerate(assembly.parts)
            },
        ),
    )  # fmt: skip
    return sheet


def _fill(part: Part) -> str:
    r, g, b = (0.55 + 0.45 * c for c in part.color)
    return to_hex((r, g, b))


def _outline(part: Part) -> np.ndarray:
    """Convex outline of a part seen along z, [n, 2] [mm]; parts are boxes, plates and discs."""
    from scipy.spatial import ConvexHull

    points = np.concatenate(plan_edges(part.solid.faces()))
    return points[ConvexHull(points).vertices]


def _draw_plan(
    sheet: DrawingSheet, assembly: Assembly, outlines: Sequence[np.ndarray], clashing: set[str]
) -> None:
    """Outlines of the made parts, above them camera and lights with their numbers."""
    order = sorted(range(len(outlines)), key=lambda k: assembly.parts[k].placeholder)
    for k in order:
        part, outline = assembly.parts[k], outlines[k]
        if not part.placeholder:
            sheet.line(np.concatenate([outline, outline[:1]]), THIN,
                       "" if part.gel or part.name == "housing" else "hidden")  # fmt: skip
            continue
        red = part.name in clashing
        sheet.area([outline], fill=_fill(part), width=THICK if red else THIN,
                   **({"edge": _RED} if red else {}))  # fmt: skip
        middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
        sheet.text((float(middle[0]), float(middle[1])), f"{k + 1}", size=2.2, align="center")
    every = np.concatenate(outlines)
    corner = float(every[:, 0].min()), float(every[:, 1].max()) + 5
    sheet.text(corner, "plan, from the touched side", bold=True)
    if clashing:
        sheet.text((corner[0], corner[1] + 6), "red: overlaps another part", color=_RED)


def _balloons(
    sheet: DrawingSheet,
    cuts: Sequence[tuple[Part, DrawnSection]],
    at,
    high: np.ndarray,
    scale: float,
) -> None:
    """Numbers beside the section, from top to bottom in the order of where they point to."""
    targets = []
    for number, (_, cut) in enumerate(cuts, start=1):
        if cut.faces:
            targets.append((number, _right_end(cut)))
    targets.sort(key=lambda item: -item[1][1])
    x = at(float(high[0]), 0)[0] + 18
    below = np.inf
    for number, point in targets:
        tip = at(*point)
        y = min(tip[1] + 4, below - _BALLOON_MM)
        below = y
        sheet.leader(tip, (x, y), f" {number} ")


def _right_end(cut: DrawnSection) -> tuple[float, float]:
    """A point inside the cut face that reaches farthest to the right."""
    loop = max((loops[0] for loops in cut.faces), key=lambda points: points[:, 0].max())
    right = loop[:, 0].max()
    near = loop[loop[:, 0] > right - 1e-6]
    inset = min(0.4, 0.3 * float(np.ptp(loop[:, 0])))
    return float(right - inset), float((near[:, 1].min() + near[:, 1].max()) / 2)


def _gap_notes(clearances: Sequence[PartClearance]) -> tuple[str, ...]:
    """Gaps between made parts, in words."""
    made = [c for c in clearances if not c.placeholder and c.gap_mm > 0]
    return tuple(f"gap {c.first} - {c.second}: {c.gap_mm:.3f} mm" for c in made)
