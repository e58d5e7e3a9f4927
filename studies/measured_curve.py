# SPDX-License-Identifier: Apache-2.0
"""Measured curves of force over depth, as a study file names them.

A table has a column of depth and one of force, and may have one of the contact's diameter, each
with its unit in its name: ``depth_mm``, ``Force (N)``, ``contact_diameter [um]``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError, naming
from taccel_lab.reading.table_file import Row, Table, read_table
from taccel_lab.reading.text_file import shown
from taccel_lab.studies.spec import require_known

if TYPE_CHECKING:
    from taccel_lab.studies.spec import Measured

_LENGTHS = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "m": 1e3, "cm": 10.0}
_FORCES = {"n": 1.0, "mn": 1e-3, "gf": 9.80665e-3, "g": 9.80665e-3, "kgf": 9.80665}
_QUANTITIES = {
    "depth_mm": (("depth", "indentation", "displacement", "penetration"), _LENGTHS),
    "force_n": (("force", "load", "normal_force"), _FORCES),
    "contact_diameter_mm": (("contact_diameter", "diameter"), _LENGTHS),
}
"""Columns by what they become: names, and factors of units."""
_NO_NUMBER = ("", "nan", "na", "n/a", "null", "none", "-")
LEAST_ROWS = 5
DEEPEST_MM, STRONGEST_N = 20.0, 1000.0
NOISE = 0.05
"""Negative forces and steps back, as parts of the largest, that noise explains."""


@dataclass(frozen=True)
class MeasuredCurve:
    """One loading of one gel by one tool."""

    spec: Measured
    depth_mm: np.ndarray
    """Past the touch that the record assumes, rising, shape [row]."""
    force_n: np.ndarray
    """Into the gel, shape [row]."""
    contact_diameter_mm: np.ndarray | None
    """NaN where a row has none, shape [row]."""
    remarks: tuple[str, ...]
    """What was left out, in words."""


def read_curve(spec: Measured) -> MeasuredCurve:
    """Read a curve, and bring it into order.

    Rows without a number are left out; so is the way back after the greatest depth; rows in another
    order are sorted. Remarks say so.

    Raises InputError, with the file: no such column, no unit or an unknown one, fewer than
    ``LEAST_ROWS`` rows, forces or depths that are negative or too large for a gel.
    """
    path = Path(spec.file)
    table = read_table(path)
    found = {name: _column(table, name) for name in _QUANTITIES}
    for name in ("depth_mm", "force_n"):
        if found[name] is None:
            words = " or ".join(_QUANTITIES[name][0])
            raise InputError(
                f"{path} lacks a column of {words} with its unit, such as {name} "
                f"(found {table.columns_shown()})"
            )
    rows: list[list[float]] = []
    lost = 0
    for row in table.rows():
        values = [math.nan if c is None else _cell(row, *c) for c in found.values()]
        if math.isnan(values[0]) or math.isnan(values[1]):
            lost += 1
        else:
            rows.append(values)
    remarks = [f"{lost} rows without a number left out"] if lost else []
    if len(rows) < LEAST_ROWS:
        raise InputError(f"{path} has {len(rows)} rows with numbers; a curve takes {LEAST_ROWS}")
    depth, force, diameter = np.array(rows).T
    with naming(path):
        _check(depth, force)
    keep, remark = _in_order(depth)
    remarks += [remark] if remark else []
    if found["contact_diameter_mm"] is None or not np.isfinite(diameter).any():
        diameter = np.full(len(depth), np.nan)
    has = bool(np.isfinite(diameter[keep]).any())
    return MeasuredCurve(
        spec, depth[keep], force[keep], diameter[keep] if has else None, tuple(remarks)
    )


def _column(table: Table, name: str) -> tuple[int, float] | None:
    """Place and factor of a column; None when there is none of that quantity."""
    words, units = _QUANTITIES[name]
    found: list[tuple[int, float]] = []
    for place, head in enumerate(table.header):
        plain = re.sub(r"[\s_\[\]()/]+", "_", head.strip().lower()).strip("_")
        for word in sorted(words, key=len, reverse=True):
            if plain != word and not plain.startswith(word + "_"):
                continue
            unit = plain[len(word) + 1 :]
            if unit not in units:
                known = ", ".join(f"{word}_{u}" for u in units if u.isascii())
                raise InputError(
                    f"{table.path}: the unit of the column {shown(head)} is not known; allowed: "
                    f"{known}"
                )
            found.append((place, units[unit]))
            break
    if len(found) > 1:
        both = " and ".join(shown(table.header[place]) for place, _ in found)
        raise InputError(f"{table.path} has the columns {both}; which one counts?")
    return found[0] if found else None


def _cell(row: Row, place: int, factor: float) -> float:
    if row.text(place).lower() in _NO_NUMBER:
        return math.nan
    return row.number(place) * factor


def _check(depth: np.ndarray, force: np.ndarray) -> None:
    """Refuse signs and sizes that cannot be meant."""
    if depth.max() <= 0 or -depth.min() > depth.max():
        raise InputError(
            f"depths run from {depth.min():g} to {depth.max():g} mm; travel into the gel is "
            "positive, so reverse the sign of the column"
        )
    if -force.min() > force.max():
        raise InputError(
            f"forces go down to {force.min():g} N; a force into the gel is positive, so reverse "
            "the sign of the column"
        )
    if -force.min() > NOISE * force.max():
        raise InputError(
            f"a force is {force.min():g} N, of at most {force.max():g} N: more than noise. Take "
            "off the load cell's offset, or leave the row out"
        )
    if depth.max() > DEEPEST_MM:
        raise InputError(
            f"depths reach {depth.max():g} mm; at most {DEEPEST_MM:g} mm: another unit?"
        )
    if force.max() > STRONGEST_N:
        raise InputError(
            f"forces reach {force.max():g} N; at most {STRONGEST_N:g} N: another unit?"
        )


def _in_order(depth: np.ndarray) -> tuple[np.ndarray, str]:
    """Rows of the loading, in order of depth, and what was done to them."""
    noise = NOISE * float(np.ptp(depth))
    peak = int(np.argmax(depth))
    rises = (depth[: peak + 1] >= np.maximum.accumulate(depth[: peak + 1]) - noise).all()
    falls = (depth[peak:] <= np.minimum.accumulate(depth[peak:]) + noise).all()
    if rises and falls and peak >= LEAST_ROWS - 1:
        remark = f"{len(depth) - 1 - peak} rows of the way back left out"
        keep = np.arange(peak + 1)
        remark = remark if peak < len(depth) - 1 else ""
    else:
        keep, remark = np.arange(len(depth)), "rows were not in order of depth; sorted"
    return keep[np.argsort(depth[keep], kind="stable")], remark


def require_measured(
    measured: Sequence[Measured],
    presses: Iterable[Any],
    names: Sequence[str],
    designs: Sequence[Mapping[str, Any]],
) -> None:
    """Refuse curves that belong to no press or design of a study, or cannot be read.

    Args:
        measured: As of the study file.
        presses: Of the study.
        names: Of its swept and fixed parameters.
        designs: Parameters of each design; empty where an optimiser finds them.
    """
    straight = [press for press in presses if getattr(press, "straight", False)]
    tools = sorted({indenter for press in straight for indenter in press.indenters})
    for number, spec in enumerate(measured):
        where = f"[[measured]] number {number + 1}"
        if spec.indenter not in tools:
            raise InputError(
                f"{where}: no press straight down has the indenter {spec.indenter!r}; known: "
                f"{', '.join(tools) or 'none'}"
            )
        for name in spec.design:
            require_known(f"swept or fixed parameter of {where}", name, names)
        if designs and not any(belongs(spec, parameters) for parameters in designs):
            words = ", ".join(f"{k} = {v}" for k, v in spec.design.items())
            raise InputError(f"{where}: no design of the sweep has {words}")
        read_curve(spec)


def belongs(spec: Measured, parameters: Mapping[str, Any]) -> bool:
    """Whether a curve is of a gel with these parameters."""
    return all(_same(parameters[name], value) for name, value in spec.design.items())


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return math.isclose(one, other, rel_tol=1e-6)
