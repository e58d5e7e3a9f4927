# SPDX-License-Identifier: Apache-2.0
"""Force records: tables with a header, checked for columns, signs, units and order."""

from __future__ import annotations

import math
from array import array
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.folder import ForceRecord
from taccel_lab.calibration.capture.record_checks import check_record
from taccel_lab.calibration.capture.schema import RecordEntry
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.loading_faults import without_repeats
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.files.table_file import read_table

COLUMNS = ("depth_mm", "force_n")
"""Those that a record of an indentation has to have."""
AIR_MM, AIR_ROWS = 0.1, 3
"""Rows so far before the touch, which is stated to about this, are in air; so many tell the load
cell's zero."""
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
