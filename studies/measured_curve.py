# SPDX-License-Identifier: Apache-2.0
"""Measured curves of force over depth, as a study file names them.

A table has a column of depth or of the machine's position and one of force, and may have one of the
contact's diameter, each with its unit in its name or in the row below: ``depth_mm``, ``Force (N)``,
``z [um]``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError, naming
from taccel_lab.files.loading_faults import require_loading, without_repeats
from taccel_lab.files.table_file import Row, Table, read_table
from taccel_lab.files.text_file import shown
from taccel_lab.studies.loading import LEAST_ROWS, find_touch, first_loading
from taccel_lab.studies.spec import require_known

if TYPE_CHECKING:
    from taccel_lab.studies.spec import Measured

_LENGTHS = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "m": 1e3, "cm": 10.0}
_FORCES = {"n": 1.0, "mn": 1e-3, "kn": 1e3, "gf": 9.80665e-3, "g": 9.80665e-3, "kgf": 9.80665}
_QUANTITIES = {
    "depth_mm": (
        ("depth", "indentation", "displacement", "penetration", "indentation_depth",
         "penetration_depth", "extension", "travel", "stroke"),
        _LENGTHS,
    ),
    "force_n": (("force", "load", "normal_force", "force_z", "fz"), _FORCES),
    "contact_diameter_mm": (("contact_diameter", "diameter"), _LENGTHS),
    "position_mm": (("position", "z", "z_position", "height"), _LENGTHS),
}  # fmt: skip
"""Columns by what they become: names, and factors of units."""
_NO_NUMBER = ("", "nan", "na", "n/a", "null", "none", "-")
LONGEST_MM = 1e3
"""Way of a test, air before the touch included [mm]."""
DEEPEST_MM, STRONGEST_N = 20.0, 1000.0
NOISE = 0.05
"""Negative forces, as a part of the largest, that noise explains."""
AIR_KEPT = 0.2
"""Rows in air that go into the fit, as a part of the way behind the touch."""


@dataclass(frozen=True)
class MeasuredCurve:
    """One loading of one gel by one tool."""

    spec: Measured
    depth_mm: np.ndarray
    """Past ``touch_mm``, rising, shape [row]."""
    force_n: np.ndarray
    """Into the gel, without what the load cell reads in air, shape [row]."""
    contact_diameter_mm: np.ndarray | None
    """NaN where a row has none, shape [row]."""
    remarks: tuple[str, ...]
    """What was left out, in words."""
    touch_mm: float = 0.0
    """Where the record touches, in its own depths; 0, as it says, where that cannot be seen."""


def read_curve(spec: Measured) -> MeasuredCurve:
    """Read a curve, and bring it into order.

    Rows without a number are left out; so are ways back and later cycles; rows in another order are
    sorted. Where the record begins in air, the touch is found in it, and what the load cell reads
    there is taken off. Remarks say so.

    Raises InputError, with the file: no such column, no unit or an unknown one, fewer than
    ``LEAST_ROWS`` rows, forces or depths that are negative or too large for a gel.
    """
    path = Path(spec.file)
    table = read_table(path)
    found = {name: _column(table, name) for name in _QUANTITIES}
    position = found["depth_mm"] is None and found["position_mm"] is not None
    if position:
        found["depth_mm"] = found["position_mm"]
    for name in ("depth_mm", "force_n"):
        if found[name] is None:
            words = " or ".join(_QUANTITIES[name][0])
            words += " or " + " or ".join(_QUANTITIES["position_mm"][0]) * (name == "depth_mm")
            raise InputError(
                f"{path} lacks a column of {words.removesuffix(' or ')} with its unit, such as "
                f"{name} (found {table.columns_shown()})"
            )
    columns = [found[name] for name in ("depth_mm", "force_n", "contact_diameter_mm")]
    rows: list[list[float]] = []
    lost = 0
    for row in islice(table.rows(), 1 if _unit_row(table) else 0, None):
        values = [math.nan if c is None else _cell(row, *c) for c in columns]
        if math.isnan(values[0]) or math.isnan(values[1]):
            lost += 1
        else:
            rows.append(values)
    remarks = [f"{lost} rows without a number left out"] if lost else []
    if len(rows) < LEAST_ROWS:
        raise InputError(f"{path} has {len(rows)} rows with numbers; a curve takes {LEAST_ROWS}")
    names = ("depth", "force", "diameter")
    depth, force, diameter = without_repeats(
        dict(zip(names, np.array(rows).T, strict=True))
    ).values()
    if position and _falls(depth, force):
        depth = -depth
        remarks.append("positions fall as the force rises: turned about")
    with naming(path):
        _check_units(depth, force)
        _check_signs(depth, force)
        keep, remark = first_loading(depth)
        remarks += [remark] if remark else []
        depth, force, diameter = depth[keep], force[keep], diameter[keep]
        depth, force, touch, remark = _from_touch(depth, force)
        remarks += [remark] if remark else []
        diameter = diameter[-len(depth) :]
        _check_sizes(depth, force)
        require_loading(
            depth, force, NOISE / 3 * float(force.max()), ball=spec.indenter.startswith("sphere:")
        )
    has = found["contact_diameter_mm"] is not None and bool(np.isfinite(diameter).any())
    return MeasuredCurve(spec, depth, force, diameter if has else None, tuple(remarks), touch)


def _from_touch(depth: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, str]:
    """Rows from shortly before the touch on, counted from there, where it is, and what was done."""
    touch = find_touch(depth, force)
    if touch is None:
        return depth, force, 0.0, ""
    drift = touch.drift_n_per_mm * np.minimum(depth - touch.depth_mm, 0.0)
    keep = depth >= touch.depth_mm - AIR_KEPT * (depth[-1] - touch.depth_mm)
    remark = (
        f"touches at {touch.depth_mm:.4g} mm, seen from {touch.air_rows} rows in air, whose "
        f"{touch.force_n:.3g} N are taken off"
    )
    rest = force - touch.force_n - drift
    return depth[keep] - touch.depth_mm, rest[keep], touch.depth_mm, remark


def _unit_row(table: Table) -> list[str] | None:
    """Units in the row below the names, in brackets or not; None where that row has none."""
    first = next(iter(table.rows()), None)
    if first is None:
        return None
    cells = [re.sub(r"[\s_\[\]()/]+", "", cell.lower()) for cell in first.cells]
    known = {**_LENGTHS, **_FORCES}
    return cells if any(cell in known for cell in cells) else None


def _column(table: Table, name: str) -> tuple[int, float] | None:
    """Place and factor of a column; None when there is none of that quantity."""
    words, units = _QUANTITIES[name]
    below = _unit_row(table)
    found: list[tuple[int, float]] = []
    problem = ""
    for place, head in enumerate(table.header):
        plain = re.sub(r"[\s_\[\]()/]+", "_", head.strip().lower()).strip("_")
        for word in sorted(words, key=len, reverse=True):
            if plain != word and not plain.startswith(word + "_"):
                continue
            unit = plain[len(word) + 1 :].removeprefix("in_")
            unit = below[place] if below is not None and not unit else unit
            if unit in units:
                found.append((place, units[unit]))
            else:
                known = ", ".join(f"{word}_{u}" for u in units if u.isascii())
                problem = problem or (
                    f"{table.path}: the unit of the column {shown(head)} is not known; allowed: "
                    f"{known}"
                )
            break
    if len(found) > 1:
        both = " and ".join(shown(table.header[place]) for place, _ in found)
        raise InputError(f"{table.path} has the columns {both}; which one counts?")
    if problem and not found and name != "position_mm":
        raise InputError(problem)
    return found[0] if found else None


def _cell(row: Row, place: int, factor: float) -> float:
    if row.text(place).lower() in _NO_NUMBER:
        return math.nan
    return row.number(place) * factor


def _falls(depth: np.ndarray, force: np.ndarray) -> bool:
    """Whether forces are larger at the lower end of the depths than at the upper one."""
    near = NOISE * np.ptp(depth)
    low, high = depth <= depth.min() + near, depth >= depth.max() - near
    return bool(force[low].mean() > force[high].mean())


def _check_signs(depth: np.ndarray, force: np.ndarray) -> None:
    """Refuse signs that cannot be meant."""
    if -force.min() > force.max():
        raise InputError(
            f"forces go down to {force.min():g} N; a force into the gel is positive, so reverse "
            "the sign of the column, or take off what the load cell reads in air"
        )
    if _falls(depth, force):
        raise InputError(
            f"depths run from {depth.min():g} to {depth.max():g} mm, and forces fall on the way; "
            "travel into the gel is positive, so reverse the sign of the column (or call it "
            "position_mm, which may have either sign)"
        )


def _check_units(depth: np.ndarray, force: np.ndarray) -> None:
    """Refuse ways and forces that no test rig has, before anything is fitted to them."""
    way = float(np.ptp(depth))
    if way > LONGEST_MM:
        raise InputError(f"depths run over {way:g} mm; at most {LONGEST_MM:g} mm: another unit?")
    if (most := float(np.abs(force).max())) > STRONGEST_N:
        raise InputError(f"forces reach {most:g} N; at most {STRONGEST_N:g} N: another unit?")


def _check_sizes(depth: np.ndarray, force: np.ndarray) -> None:
    """Refuse depths from the touch and forces that no gel has."""
    if -depth.min() > depth.max():
        raise InputError(
            f"depths run from {depth.min():g} to {depth.max():g} mm, and no touch is seen in them: "
            "some rows in air before it are needed, or depths counted from the touch"
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
