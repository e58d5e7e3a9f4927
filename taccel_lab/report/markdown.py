# SPDX-License-Identifier: Apache-2.0
"""Tables, and generated parts, of Markdown files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from taccel_lab.errors import InputError


def markdown_table(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """A table; cells as their text."""
    head = list(head)
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def with_parts(page: str, parts: Mapping[str, str]) -> str:
    """A page with new text between each ``<!-- begin NAME -->`` and ``<!-- end NAME -->``.

    Raises InputError where a part has no place.
    """
    for name, text in parts.items():
        begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
        if page.count(begin) != 1 or page.count(end) != 1:
            raise InputError(f"the page must have one {begin} and one {end}")
        between = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
        page = between.sub(lambda _, body=f"{begin}\n{text}\n{end}": body, page)
    return page
