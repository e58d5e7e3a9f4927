# SPDX-License-Identifier: Apache-2.0
"""How results and their numbers are written in generated pages."""

from __future__ import annotations

from typing import Any

Document = dict[str, Any]
Results = dict[str, list[Document]]
NOTHING = "No result yet."


def number(value: float | None, digits: int = 3) -> str:
    """Three digits that count, thousands grouped."""
    if value is None:
        return "-"
    if value == 0:
        return "0"
    if abs(value) >= 1000:
        return f"{round(value):,}"
    if abs(value) < 1e-3:
        return f"{value:.1e}"
    return f"{value:.{digits}g}"
