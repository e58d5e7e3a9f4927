# SPDX-License-Identifier: Apache-2.0
"""A board as a person writes it on the command line: ``chessboard:6x6:2.5``."""

from __future__ import annotations

import re
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.files.cell_number import number

_BOARD = re.compile(r"^(chessboard|charuco|dots):([0-9]{1,4})x([0-9]{1,4})(?::([0-9.]+))?$")


def board_entry(text: str) -> dict[str, Any]:
    """Kind, columns, rows and, where it is given, pitch of a board, as keys of its entry.

    Raises InputError when ``text`` is not ``kind:COLUMNSxROWS[:pitch_mm]``.
    """
    match = _BOARD.match(text)
    if match is None:
        raise InputError(
            f"board {text!r}; kind:COLUMNSxROWS[:pitch_mm] is allowed, such as chessboard:6x6:2.5 "
            "(kinds chessboard, charuco, dots)"
        )
    entry: dict[str, Any] = {"kind": match[1], "columns": int(match[2]), "rows": int(match[3])}
    if match[4] is not None:
        try:
            entry["pitch_mm"] = number(match[4])
        except ValueError as error:
            raise InputError(f"board {text!r}: the pitch: {error}") from None
    return entry
