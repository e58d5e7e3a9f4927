# SPDX-License-Identifier: Apache-2.0
"""A console that shows words as they are: no markup, and no control characters of others.

Names of files, sensors and records are anybody's, and so is what their bytes do to a terminal.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from taccel_lab.printable import printable_lines


class PlainConsole(Console):
    """Brackets are no markup, here and in tables: ``[design]`` is a part of a file."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, highlight=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return words as a printable text, before its room in a table is measured."""
        return super().render_str(printable_lines(text), **options)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Return the segments of anything that rich can draw, each with printable text."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment(printable_lines(segment.text), segment.style)
