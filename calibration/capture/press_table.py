# SPDX-License-Identifier: Apache-2.0
"""Depths and places of presses that a stage made, from the table that it went by."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from taccel_lab.calibration.capture.printer import COLUMNS
from taccel_lab.errors import InputError
from taccel_lab.files.table_file import read_table


def read_press_table(path: Path) -> list[dict[str, Any]]:
    """``depth_mm`` and ``stage_mm`` of each press, in the order in which they were made.

    Raises:
        InputError: No such table, or a value that is none of a press.
    """
    table = read_table(path)
    x, y, depth = (table.require_column(name) for name in COLUMNS[1:4])
    found = []
    for row in table.rows():
        deep = row.number(depth)
        if not 0 < deep <= 50:
            raise row.error(f"depth_mm is {deep:g}; 0 to 50 mm is allowed")
        found.append({"depth_mm": deep, "stage_mm": [row.number(x), row.number(y)]})
    if not found:
        raise InputError(f"{path} has no presses")
    return found
