# SPDX-License-Identifier: Apache-2.0
"""JSON files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.files.plain_values import (
    MAX_DEPTH,
    first_repeated,
    require_plain_values,
)
from taccel_lab.files.text_file import read_text, shown

JSON_LIMIT_BYTES = 8 << 20
"""Most bytes of a file, as TOML's; the results of a design have some 100 KiB."""
_MAX_DIGITS = 20


def read_json(path: Path) -> dict[str, Any]:
    """Content of a JSON file that holds an object.

    Raises InputError with the path: no file, too large, no text, no JSON or no object, nested too
    deep, a key that stands twice, numbers that are not finite or too large.
    """
    text = read_text(path, JSON_LIMIT_BYTES, "a JSON file")
    try:
        document = json.loads(
            text, object_pairs_hook=_object, parse_constant=_constant, parse_int=_whole
        )
    except RecursionError:
        raise InputError(f"{path} is nested more than {MAX_DEPTH} deep") from None
    except ValueError as error:
        raise InputError(f"{path} is not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise InputError(f"{path} holds {shown(document)}; an object {{...}} of keys is needed")
    return require_plain_values(document, str(path))


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = shown(first_repeated(name for name, _ in pairs))
        raise ValueError(f"the key {twice} stands twice")
    return found


def _constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _whole(digits: str) -> int:
    if len(digits) > _MAX_DIGITS:
        raise ValueError(f"a whole number of {len(digits)} digits; 64 bits are allowed")
    return int(digits)
