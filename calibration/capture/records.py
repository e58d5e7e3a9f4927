# SPDX-License-Identifier: Apache-2.0
"""Force records: CSV files with a header, checked for columns, signs, units and order."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.folder import ForceRecord
from taccel_lab.calibration.capture.record_checks import check_record
from taccel_lab.calibration.capture.schema import RecordEntry
from taccel_lab.errors import InputError
from taccel_lab.inner_path import inner_path
from taccel_lab.reading.regular_file import file_sha256

COLUMNS = {
    "indentation": ("depth_mm", "force_n"),
    "slide": ("shift_mm", "normal_n", "tangential_n"),
    "shear": ("depth_mm", "shift_mm", "normal_n", "tangential_n"),
    "twist": ("depth_mm", "angle_deg", "torque_nmm"),
    "relaxation": ("time_s", "depth_mm", "force_n"),
}
"""Columns that each kind of record has to have."""


def load_record(folder: Path, entry: RecordEntry) -> ForceRecord:
    """Read one record; InputError names the file, the column or row, and what is allowed."""
    path = inner_path(folder, entry.file)
    columns = read_columns(path)
    missing = [name for name in COLUMNS[entry.kind] if name not in columns]
    if missing:
        raise InputError(
            f"{path} lacks the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}; a "
            f"record of kind {entry.kind} has {', '.join(COLUMNS[entry.kind])} (found "
            f"{', '.join(columns)})"
        )
    check_record(str(path), entry, columns)
    return ForceRecord(entry, str(path), file_sha256(path), columns)


def kind_of_record(path: Path) -> str | None:
    """Kind whose columns a CSV has, the one with most columns; None when it is no record."""
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
        header = {name.strip() for name in next(csv.reader(stream), [])}
    fitting = [kind for kind, names in COLUMNS.items() if header.issuperset(names)]
    return max(fitting, key=lambda kind: len(COLUMNS[kind]), default=None)


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Columns of a CSV by name, float64, shape [row]; at least two rows of finite numbers."""
    if not path.is_file():
        raise InputError(f"{path} does not exist; the manifest names it")
    # Spreadsheets put a byte order mark first; other bytes than UTF-8 are no numbers anyway.
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
        rows = [row for row in csv.reader(stream) if row and not row[0].startswith("#")]
    if len(rows) < 3:
        raise InputError(f"{path} holds {max(len(rows) - 1, 0)} rows; a header and at least 2")
    header = [name.strip() for name in rows[0]]
    values = np.empty((len(rows) - 1, len(header)))
    for i, row in enumerate(rows[1:]):
        if len(row) != len(header):
            raise InputError(f"{path}: row {i + 1} has {len(row)} cells, the header {len(header)}")
        for j, cell in enumerate(row):
            try:
                values[i, j] = float(cell)
            except ValueError:
                values[i, j] = math.nan
            if not math.isfinite(values[i, j]):
                raise InputError(
                    f"{path}: row {i + 1}, column {header[j]}: {cell!r} is not a finite number"
                )
    return {name: values[:, j] for j, name in enumerate(header)}
