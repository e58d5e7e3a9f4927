# SPDX-License-Identifier: Apache-2.0
"""What an object says of itself: a title and a few named figures, in a terminal or a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

MOST_COLUMNS = 110
"""Most columns of a line; what is longer is cut."""


class Summary:
    """An object whose ``repr`` is a title and rows of names and values.

    A dataclass that inherits it needs ``repr=False``.
    """

    def summary(self) -> tuple[str, Sequence[tuple[str, str]]]:
        """The title, and the rows."""
        raise NotImplementedError

    def __repr__(self) -> str:
        title, rows = self.summary()
        width = max((len(name) for name, _ in rows), default=0)
        lines = [title, *(f"  {name:<{width}}  {value}" for name, value in rows)]
        return "\n".join(_cut(line) for line in lines)

    def _repr_html_(self) -> str:
        title, rows = self.summary()
        cells = "".join(
            f'<tr><th style="text-align:left">{escape(name)}</th>'
            f'<td style="text-align:left">{escape(value)}</td></tr>'
            for name, value in rows
        )
        return f"<table><caption><b>{escape(title)}</b></caption>{cells}</table>"


def _cut(line: str) -> str:
    return line if len(line) <= MOST_COLUMNS else line[: MOST_COLUMNS - 3] + "..."
