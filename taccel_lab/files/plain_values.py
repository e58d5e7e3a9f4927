# SPDX-License-Identifier: Apache-2.0
"""What may stand in a TOML, JSON or YAML file: shallow, finite, of a sane size."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.files.text_file import shown
from taccel_lab.printable import printable

MAX_DEPTH = 32
"""Most levels of tables and lists in one another; our own files reach 6."""
MAX_VALUES = 250_000
"""Most values in one file: 30,000 presses with all that can be said of them. It bounds the memory
of what is made of a file, and of the messages about its faults."""
_MAX_WHOLE = 2**63
"""Whole numbers have 64 bits, as TOML has it."""
_Place = tuple[Any, Any] | None


def require_plain_values(document: Any, source: str) -> Any:
    """``document``, if nothing in it is too deep, not finite, too large or no text.

    Raises InputError with ``source`` and the key.
    """
    stack: list[tuple[Any, _Place, int]] = [(document, None, 0)]
    count = 0
    while stack:
        value, place, depth = stack.pop()
        if isinstance(value, (dict, list)):
            if depth == MAX_DEPTH:
                raise InputError(
                    f"{source} is nested more than {MAX_DEPTH} deep (at {_path(place)[:60]}...)"
                )
            count += len(value)
            if count > MAX_VALUES:
                raise InputError(f"{source} holds more than {MAX_VALUES:,} values")
            pairs: Iterable[tuple[Any, Any]]
            if isinstance(value, dict):
                for key in value:
                    _require_text(key, source, place)
                pairs = value.items()
            else:
                pairs = enumerate(value)
            stack += [(inner, (place, key), depth + 1) for key, inner in pairs]
        elif isinstance(value, str):
            _require_text(value, source, place)
        elif isinstance(value, float) and not math.isfinite(value):
            raise InputError(
                f"{source}: {_path(place)} is {value}, or too large; a finite number is needed"
            )
        elif isinstance(value, int) and not -_MAX_WHOLE <= value < _MAX_WHOLE:
            raise InputError(
                f"{source}: {_path(place)} is a whole number of {value.bit_length()} bits; "
                "63 are allowed"
            )
    return document


def number_at(document: Any, keys: str, source: str) -> float:
    """The number at ``keys`` (``sensor.pixmm``); InputError when there is none."""
    value = document
    for key in keys.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        found = "is missing" if value is None else f"is {shown(value)}"
        raise InputError(f"{source}: {keys} {found}; a number is needed")
    return float(value)


def first_repeated(names: Iterable[str]) -> str | None:
    """The first name that stood before; None when each is another."""
    seen = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


def _require_text(value: Any, source: str, place: _Place) -> None:
    if not isinstance(value, str):
        raise InputError(f"{source}: {_path(place)}: the key {shown(value)} is no text")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{source}: {_path(place)}: {shown(value)} holds half a character (a lone surrogate)"
        ) from None


def _path(place: _Place) -> str:
    parts: list[str] = []
    while place is not None:
        place, key = place
        parts.append(printable(key))
    return ".".join(reversed(parts)) or "the file"
