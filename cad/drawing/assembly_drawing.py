# SPDX-License-Identifier: Apache-2.0
"""An assembly in section: the plane y = 0 with numbered parts, overall sizes and a parts list."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import to_hex

from taccel_lab.cad.assembly import Assembly
from taccel_lab.cad.drawing.sections import Section, section
from taccel_lab.cad.drawing.sheet import THIN, Sheet, Xy
from taccel_lab.cad.drawing.title import (
    SHEETS,
    TABLE_WIDTH_MM,
    TitleBlock,
    mm_words,
    sheet_and_scale,
    write_title,
)
from taccel_lab.cad.parts.part import Part

_HATCHES = ("////", "\\\\\\\\", "", "xx", "..", "//", "\\\\")
_MARGINS = np.array([84.0, 52.0])
_BALLOON_MM = 9.0


def write_assembly_drawing(
    assembly: Assembly, paths: Sequence[Path], *, title: str, notes: Sequence[str] = ()
) -> None:
    """Draw the section y = 0 of ``assembly`` (z up) and write it to ``paths``.

    Parts that the plane misses are listed without a number in the section.
    """
    cuts = [(part, section(part.solid, "x")) for part in assembly.parts]
    every = np.concatenate([loop for _, cut in cuts for loops in cut.faces for loop in loops])
    low, high = every.min(axis=0), every.max(axis=0)
    name, scale = sheet_and_scale(lambda s: s * (high - low) + _MARGINS, least=1.5)
    sheet = Sheet(*SHEETS[name])
    room = np.array([sheet.width_mm - 16 - TABLE_WIDTH_MM, sheet.height_mm - 16])
    origin = 8 + room / 2 - scale * (low + high) / 2

    def at(u: float, v: float) -> Xy:
        return float(origin[0] + scale * u), float(origin[1] + scale * v)

    for k, (part, cut) in enumerate(cuts):
        r, g, b = (0.55 + 0.45 * c for c in part.color)
        fill = to_hex((r, g, b))
        for loops in cut.faces:
            sheet.area(
                [origin + scale * loop for loop in loops], fill=fill, width=THIN * 1.4,
                hatch="" if part.placeholder else _HATCHES[k % len(_HATCHES)],
            )  # fmt: skip
    sheet.line([at(0, low[1] - 2 / scale), at(0, high[1] + 4 / scale)], THIN / 1.5, "axis")
    sheet.dimension(at(low[0], low[1]), at(high[0], low[1]), -12,
                    mm_words(high[0] - low[0]), along="x")  # fmt: skip
    sheet.dimension(at(low[0], low[1]), at(low[0], high[1]), 14,
                    mm_words(high[1] - low[1]), along="y")  # fmt: skip
    _balloons(sheet, cuts, at, high, scale)
    sheet.text(at(float(low[0]), float(high[1]) + 8 / scale), "section y = 0", bold=True)
    write_title(
        sheet,
        TitleBlock(
            title=title, material="see the list of parts", scale=scale, sheet=name,
            notes=(*_gap_notes(assembly), *notes), what="assembly",
            volume_mm3=sum(p.solid.volume for p in assembly.parts if not p.placeholder),
            heading=("part", "volume", "mm³"),
            parameters={
                f"{k + 1} {part.name} ({part.material})": (round(part.solid.volume, 1), "")
                for k, part in enumerate(assembly.parts)
            },
        ),
    )  # fmt: skip
    for path in paths:
        sheet.save(path)


def _balloons(
    sheet: Sheet, cuts: Sequence[tuple[Part, Section]], at, high: np.ndarray, scale: float
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


def _right_end(cut: Section) -> tuple[float, float]:
    """A point inside the cut face that reaches farthest to the right."""
    loop = max((loops[0] for loops in cut.faces), key=lambda points: points[:, 0].max())
    right = loop[:, 0].max()
    near = loop[loop[:, 0] > right - 1e-6]
    inset = min(0.4, 0.3 * float(np.ptp(loop[:, 0])))
    return float(right - inset), float((near[:, 1].min() + near[:, 1].max()) / 2)


def _gap_notes(assembly: Assembly) -> tuple[str, ...]:
    """Gaps between made parts, in words."""
    made = [c for c in assembly.clearances() if not c.placeholder and c.gap_mm > 0]
    return tuple(f"gap {c.first} - {c.second}: {c.gap_mm:.3f} mm" for c in made)
