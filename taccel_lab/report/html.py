# SPDX-License-Identifier: Apache-2.0
"""What templates of pages need: the environment, numbers and pictures as text."""

from __future__ import annotations

import base64
import math
import re
from typing import Any


def image_suffix(image: bytes) -> str:
    """How the name of a JPEG or a PNG file ends, by its first bytes."""
    return ".jpg" if image.startswith(b"\xff\xd8") else ".png"


def data_url(image: bytes) -> str:
    """A PNG or a JPEG file as text that a page embeds."""
    kind = "jpeg" if image_suffix(image) == ".jpg" else "png"
    return f"data:image/{kind};base64," + base64.b64encode(image).decode()


def report_environment() -> Any:
    """Jinja2 environment of the templates here."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("taccel_lab.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = format_number
    environment.filters["breakable"] = _breakable
    return environment


def _breakable(name: str) -> Any:
    """A name that may go on in another line after each of its underscores and colons."""
    import markupsafe

    text = str(markupsafe.escape(name))
    return markupsafe.Markup(re.sub(r"([_:])(?=\S)", r"\1<wbr>", text))


def format_number(value: Any, digits: int | None = None) -> str:
    """A number for a table cell: fixed digits, or four significant ones; a dash for none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if digits is not None:
        return f"{value:.{digits}f}"
    if isinstance(value, int):
        return f"{value:,}"
    size = abs(value)
    if size != 0 and (size < 1e-3 or size >= 1e5):
        return f"{value:.2e}"
    return f"{value:.4g}"
