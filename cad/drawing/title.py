# SPDX-License-Identifier: Apache-2.0
"""What every drawing has: its sheet and scale, and the column with parameters, notes and title."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from taccel_lab.cad.drawing.sheet import THICK, DrawingSheet

TABLE_WIDTH_MM = 84.0
SHEETS = {"A4": (297.0, 210.0), "A3": (420.0, 297.0)}
SCALES = (20.0, 10.0, 5.0, 4.0, 3.0, 2.0, 1.5, 1.0, 0.5, 0.2, 0.1)
_ROW_MM = 4.6
_SMALL = 2.5
_MARGIN = 8.0
_NAME = 42


GEL_TOLERANCES = "ISO 3302-1 class M2 (moulded rubber)"
"""Where no other is stated: +-0.10 mm up to 4 mm, +-0.25 mm from 16 to 25 mm, in one mould half."""
PART_TOLERANCES = "ISO 2768-1 medium; gel ISO 3302-1 class M2"


@dataclass(frozen=True)
class Issue:
    """Which state of a design a drawing shows, and when it was made."""

    revision: str
    """Stands for all parameters: equal designs of one version of the program have one revision."""
    date: str
    """Year-month-day, UTC."""


@dataclass(frozen=True)
class TitleBlock:
    """What the column states."""

    title: str
    material: str
    scale: float
    sheet: str
    parameters: Mapping[str, tuple[float | int | str, str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    volume_mm3: float = 0.0
    what: str = "gel"
    heading: tuple[str, str, str] = ("option of --set", "value", "unit")
    tolerances: str = GEL_TOLERANCES
    issue: Issue | None = None


def sheet_and_scale(needed_mm: Callable[[float], np.ndarray], *, least: float) -> tuple[str, float]:
    """The largest scale that fits A4 if it is at least ``least``, else A3.

    ``needed_mm``: width and height on the sheet of everything beside the column, at a scale [2].
    """
    for name, (width, height) in SHEETS.items():
        room = np.array([width - 16 - TABLE_WIDTH_MM, height - 16])
        fitting = [scale for scale in SCALES if (needed_mm(scale) <= room).all()]
        if fitting and (fitting[0] >= least or name == "A3"):
            return name, fitting[0]
    return "A3", SCALES[-1]


def mm_words(value: float) -> str:
    """A length as drawings state it: up to a micrometre, without trailing zeros."""
    return f"{value:.3f}".rstrip("0").rstrip(".") if abs(value) < 100 else f"{value:.1f}"


def scale_words(scale: float) -> str:
    """5 -> "5:1", 0.5 -> "1:2"."""
    return f"{scale:g}:1" if scale >= 1 else f"1:{1 / scale:g}"


def write_title(sheet: DrawingSheet, block: TitleBlock) -> None:
    """Fill the column from the top with parameters and notes, at the bottom the title."""
    left = sheet.width_mm - _MARGIN - TABLE_WIDTH_MM
    bottom = _title(sheet, block, left)
    y = sheet.height_mm - _MARGIN
    sheet.line([(left, y), (left, _MARGIN)], THICK)
    y = _table(sheet, block, left, y, bottom)
    for note in block.notes:
        for line in textwrap.wrap(note, 52):
            y -= 4.0
            sheet.text((left + 3, y), line, size=_SMALL)
        y -= 1.5


def _table(sheet: DrawingSheet, block: TitleBlock, left: float, y: float, bottom: float) -> float:
    if not block.parameters:
        return y - 4
    right = sheet.width_mm - _MARGIN
    rows = list(block.parameters.items())
    row_mm = min(_ROW_MM, (y - bottom - 26) / (len(rows) + 1))
    text = min(_SMALL, 0.6 * row_mm)
    y -= row_mm
    sheet.text((left + 3, y + row_mm / 2), block.heading[0], size=text, bold=True)
    sheet.text((right - 14, y + row_mm / 2), block.heading[1], size=text, bold=True, align="right")
    sheet.text((right - 12, y + row_mm / 2), block.heading[2], size=text, bold=True)
    sheet.line([(left, y), (right, y)])
    for name, (value, unit) in rows:
        y -= row_mm
        words = f"{value:g}" if isinstance(value, (int, float)) else str(value)
        sheet.text((left + 3, y + row_mm / 2), textwrap.shorten(name, _NAME), size=text)
        sheet.text((right - 14, y + row_mm / 2), words, size=text, align="right")
        sheet.text((right - 12, y + row_mm / 2), "" if unit == "1" else unit, size=text)
    sheet.line([(left, y), (right, y)])
    return y - 2


def _title(sheet: DrawingSheet, block: TitleBlock, left: float) -> float:
    """Draw the title block; returns the height of its top edge."""
    right, y = sheet.width_mm - _MARGIN, _MARGIN
    issue = block.issue
    rows = [
        *([("revision", issue.revision), ("date", issue.date)] if issue else []),
        ("scale", f"{scale_words(block.scale)}   ({block.sheet})"),
        ("dimensions", "mm, third-angle projection"),
        ("tolerances", block.tolerances),
        ("frame", "x right, y up as seen from the touched side; origin at the apex"
         if block.what == "gel" else "gel frame, z out of the gel"),
        ("volume", f"{block.volume_mm3:.1f} mm³"),
        ("material", block.material),
    ]  # fmt: skip
    for name, words in rows:
        lines = textwrap.wrap(words, 40)
        height = 2.2 + 3.4 * len(lines)
        sheet.text((left + 3, y + height / 2), name, size=_SMALL, color="#555555")
        for k, line in enumerate(lines):
            sheet.text((left + 24, y + height - 2.8 - 3.4 * k), line, size=_SMALL)
        y += height
        sheet.line([(left, y), (right, y)])
    height = 12.0
    sheet.text((left + 3, y + height / 2), block.title, size=4.2, bold=True)
    y += height
    sheet.line([(left, y), (right, y)], THICK)
    return y
