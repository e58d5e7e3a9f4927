# SPDX-License-Identifier: Apache-2.0
"""Numbers written as text: in the cells of tables, and on the command line."""

from __future__ import annotations

import math
import re

MAX_CHARACTERS = 64
"""A double needs 24."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


def number(text: str) -> float:
    """The finite number that ``text`` is, spaces around it aside: ``1``, ``-0.5``, ``2.5e-3``.

    Python reads ``1_0``, ``nan``, ``infinity`` and the digits of any script as numbers, too; in a
    table they are slips. Raises ValueError otherwise.
    """
    stripped = text.strip(" \t")
    if len(stripped) > MAX_CHARACTERS or not _NUMBER.fullmatch(stripped):
        raise ValueError(f"{text[:MAX_CHARACTERS]!r} is not a number")
    value = float(stripped)
    if not math.isfinite(value):
        raise ValueError(f"{text[:MAX_CHARACTERS]!r} is not a finite number")
    return value
