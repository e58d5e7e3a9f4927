# SPDX-License-Identifier: Apache-2.0
"""Force records: tables with a header, checked for columns, signs, units and order."""

from __future__ import annotations

import math
from array import array
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.folder import ForceRecord
from taccel_lab.calibration.capture.schema import RecordEntry, ToolEntry
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError, naming
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.loading_faults import require_loading, without_repeats
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.files.table_file import read_table

COLUMNS = ("depth_mm", "force_n")
"""Columns that a record of an indentation has to have."""
AIR_MM, AIR_ROWS = 0.1, 3
"""Rows so far before the touch, which is stated to about this, are in air; this number tells the
load cell's zero."""
AIR_SHARE = 0.1
"""Largest change of the force in air, as a part of the loading's."""


def load_record(folder: Path, entry: RecordEntry) -> ForceRecord:
    """Read one record; InputError names the file, the column or row, and what is allowed."""
    path = inner_path(folder, entry.file)
    columns = read_columns(path)
    missing = [name for name in COLUMNS if name not in columns]
    if missing:
        raise InputError(
            f"{path} lacks the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}; a "
            f"record of kind {entry.kind} has {', '.join(COLUMNS)} (found "
            f"{', '.join(columns)})"
        )
    columns, zero = _past_touch(without_repeats(columns))
    check_record(str(path), entry, columns)
    return ForceRecord(entry, str(path), file_sha256(path), columns, zero)


def _past_touch(
    columns: dict[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], Estimate | None]:
    """A loading without its rows in air, and what the load cell reads there, which is taken off.

    Left as it is where rows above the touch are few, or show a force that grows: then the depth's
    sign may be reversed.
    """
    depth, force = columns["depth_mm"], columns["force_n"]
    air = depth < -AIR_MM
    if air.sum() < AIR_ROWS or (depth > 0).sum() == 0:
        return columns, None
    zero = float(force[air].mean())
    reach = float(np.abs(force[depth > 0] - zero).max())
    if np.ptp(force[air]) > AIR_SHARE * reach:
        return columns, None
    # Neighbouring readings err alike, and slow drift goes on: halves show both.
    halves = [float(part.mean()) for part in np.array_split(force[air], 2)]
    sigma = math.hypot(float(force[air].std(ddof=1)) / math.sqrt(air.sum()), halves[1] - halves[0])
    below = {name: values[depth > 0] for name, values in columns.items()}
    below["force_n"] = below["force_n"] - zero
    return below, Estimate(zero, sigma, "N")


def is_record(path: Path) -> bool:
    """Whether a table has a record's columns; InputError for a file that is no table at all."""
    return set(COLUMNS) <= set(read_table(path).header)


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Columns of a table by name, float64, shape [row]; at least two rows of finite numbers."""
    table = read_table(path)
    if "" in table.header:
        raise InputError(f"{path}: column {table.header.index('') + 1} has no name")
    # Arrays take a tenth of the memory that lists of numbers do.
    columns = [array("d") for _ in table.header]
    for row in table.rows():
        for index, column in enumerate(columns):
            column.append(row.number(index))
    if len(columns[0]) < 2:
        raise InputError(f"{path} holds {len(columns[0])} rows; a header and at least 2")
    return {
        name: np.array(column, dtype=np.float64)
        for name, column in zip(table.header, columns, strict=True)
    }


SOFTEST_MPA, STIFFEST_MPA = 2e-4, 10.0
"""Apparent moduli of gels on a window: from the softest silicone to 1 MPa ten times stiffened."""
LIKELY_MPA = (0.005, 3.0)
FORCE_UNITS = {"mN": 1e-3, "grams": 9.80665e-3, "ounces": 0.278, "kg": 9.80665, "kN": 1e3}
"""Newtons of a unit that a cell may have been read in."""
TIMES = {"time", "time_s", "time_ms", "t", "t_s"}
"""Names of a column that only has to run forward."""
MAX_DEPTH_MM = 20.0
MIN_DEPTH_MM = 0.02
FORCE_TOLERANCE = 0.05
"""Drop of a force, relative to the largest, that noise explains where no sigma is stated."""
UNKNOWN_TOOL_MM = (0.5, 20.0)
"""Radii that a tool of unstated size may have."""


def check_record(path: str, entry: RecordEntry, columns: dict[str, np.ndarray]) -> None:
    """Refuse a record whose units, signs or order cannot be meant.

    Units are judged by what they would mean: Hertz' formula ``E* = 3 F / (4 sqrt(R) d^1.5)`` (K. L.
    Johnson, Contact Mechanics, 1985, eq. 4.23) turns a force and a depth into a modulus, and
    silicone gels lie between 1 kPa and a few MPa. A thin layer on a hard window looks up to ten
    times as stiff.

    Raises:
        InputError: Names the file, the row where there is one, what was found and what is allowed.
    """
    depth, force = columns["depth_mm"], columns["force_n"]
    sigma = columns.get("sigma_n", np.array(FORCE_TOLERANCE / 3 * np.abs(force).max()))
    tool = entry.tool
    with naming(path):
        if "sigma_n" in columns and (sigma <= 0).any():
            raise InputError("sigma_n has to be positive everywhere")
        if "sigma_n" in columns and sigma.min() > np.abs(force).max():
            raise InputError(
                f"sigma_n is at least {sigma.min():g} N, the largest force {force.max():g} N: of "
                "such a record no force is known; sigma_n is in newtons, too"
            )
        for name in TIMES & set(columns):
            hint = "the rows are not in the order of the loading; is it an unloading?"
            _require_growing(name, columns[name], hint)
        noise = float(sigma.max()) if entry.force_sigma_n is None else entry.force_sigma_n
        _check_sign(force, noise)
        _check_depth(depth)
        hint = "a record holds one loading in order: cut the unloading off, or sort the points"
        _require_growing("depth_mm", depth, hint)
        _check_rising(force, noise)
        if tool.kind == "sphere":  # Hertz measures no flat ends; fits of material check those.
            _check_force_unit(tool, depth, force)
        # A tool that nobody states may have a flat end.
        ball = tool.kind == "sphere" and tool.radius_mm is not None
        require_loading(depth, force, noise, ball=ball)


def _check_sign(force: np.ndarray, sigma_n: float) -> None:
    limit = -3 * sigma_n
    below = np.flatnonzero(force < limit)
    if len(below) == 0:
        return
    if len(below) > len(force) / 2 or abs(force.min()) > force.max():
        raise InputError(
            f"force_n is negative (down to {force.min():g} N); a force into the gel "
            "is positive, so the sign of the column is reversed"
        )
    raise InputError(
        f"row {below[0] + 1} has force_n = {force[below[0]]:g} N; a force into the "
        "gel is positive, and this is more than noise. Remove the offset or the row"
    )


def _check_depth(depth: np.ndarray) -> None:
    largest = float(np.abs(depth).max())
    if depth.min() < -0.05 * largest:
        row = int(np.argmin(depth))
        raise InputError(
            f"row {row + 1} has depth_mm = {depth[row]:g}; travel past first touch "
            "is positive into the gel. Reverse the column's sign, or cut the approach off"
        )
    if largest > MAX_DEPTH_MM:
        hint = " (micrometres?)" if largest < MAX_DEPTH_MM * 1e3 else ""
        raise InputError(f"depth_mm reaches {largest:g}; at most {MAX_DEPTH_MM:g} mm{hint}")
    if largest < MIN_DEPTH_MM:
        raise InputError(
            f"depth_mm reaches only {largest:g}; at least {MIN_DEPTH_MM:g} mm. "
            "Depths in metres have to be multiplied by 1000"
        )


def _require_growing(name: str, values: np.ndarray, hint: str) -> None:
    wrong = np.flatnonzero(np.diff(values) < 0)
    if len(wrong):
        row = int(wrong[0])
        raise InputError(
            f"{name} falls from {values[row]:g} to {values[row + 1]:g} in row {row + 2}: {hint}"
        )


def _check_rising(force: np.ndarray, sigma_n: float) -> None:
    tolerance = max(3 * sigma_n, 1e-9)
    highest = np.maximum.accumulate(force)
    wrong = np.flatnonzero(force < highest - tolerance)
    if len(wrong):
        row = int(wrong[0])
        raise InputError(
            f"force_n falls to {force[row]:g} N in row {row + 1} after "
            f"{highest[row]:g} N at a smaller depth; the force of a loading rises. The gel has "
            "slipped or torn, or the rows are of different presses"
        )


def apparent_modulus_mpa(depth_mm: np.ndarray, force_n: np.ndarray, radius_mm: float) -> float:
    """Hertz' reduced modulus of the deeper half of a record, its median [MPa = N/mm2]."""
    deep = (depth_mm > 0.5 * depth_mm.max()) & (force_n > 0)
    if not deep.any():
        return float("nan")
    return float(np.median(0.75 * force_n[deep] / (np.sqrt(radius_mm) * depth_mm[deep] ** 1.5)))


def _check_force_unit(tool: ToolEntry, depth: np.ndarray, force: np.ndarray) -> None:
    radii = (tool.radius_mm,) * 2 if tool.radius_mm is not None else UNKNOWN_TOOL_MM
    lowest, highest = (apparent_modulus_mpa(depth, force, radius) for radius in reversed(radii))
    if not np.isfinite(lowest):
        raise InputError("no force is positive; newtons into the gel are needed")
    if lowest > STIFFEST_MPA:
        fitting = [
            unit
            for unit, newtons in FORCE_UNITS.items()
            if newtons < 1 and LIKELY_MPA[0] <= lowest * newtons <= LIKELY_MPA[1]
        ]
        guess = f"; read as {' or '.join(fitting)} it would be a gel" if fitting else ""
        raise InputError(
            f"a force of {force.max():g} N at {depth.max():g} mm makes the gel "
            f"{lowest:.3g} MPa stiff; gels on a window look at most {STIFFEST_MPA:g} MPa{guess}; "
            "force_n is in newtons, depth_mm in millimetres"
        )
    if highest < SOFTEST_MPA:
        raise InputError(
            f"a force of {force.max():g} N at {depth.max():g} mm makes the gel "
            f"{highest * 1e3:.2g} kPa stiff, at least {SOFTEST_MPA * 1e3:g} kPa; force_n is in "
            "newtons (kN or kgf?), depth_mm in millimetres"
        )
