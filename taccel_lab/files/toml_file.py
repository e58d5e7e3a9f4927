# SPDX-License-Identifier: Apache-2.0
"""TOML files."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.files.plain_values import MAX_DEPTH, require_plain_values
from taccel_lab.files.text_file import read_text

TOML_LIMIT_BYTES = 4 << 20
"""A manifest of 14,000 presses; the parser, in Python, reads half a MiB a second."""
_PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*"""
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:{_PART}\.[ \t]*){{{MAX_DEPTH}}}""")
"""``a.b.c. ...``: the parser's time grows with the square of a key's parts."""
_LONG_NUMBER = re.compile(r"(?<![0-9_])[0-9][0-9_]{999}|0x[0-9A-Fa-f_]{1000}")
"""The parser's memory is a hundred times that of a number's digits."""


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file.

    Raises InputError with the path: no file, too large, no text, no TOML, nested too deep, numbers
    that are not finite or too large.
    """
    text = read_text(path, TOML_LIMIT_BYTES, "a TOML file")
    if found := _LONG_KEY.search(text):
        raise InputError(
            f"{path} is nested more than {MAX_DEPTH} deep: line {_line(text, found)} has a key of "
            "more parts"
        )
    if found := _LONG_NUMBER.search(text):
        raise InputError(f"{path}: line {_line(text, found)} has a number of 1,000 digits or more")
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path} is nested more than {MAX_DEPTH} deep") from None
    except ValueError as error:  # TOMLDecodeError is one; so are 5,000 digits.
        raise InputError(f"{path} is not valid TOML: {error}") from None
    return require_plain_values(document, str(path))


def _line(text: str, found: re.Match[str]) -> int:
    return text.count("\n", 0, found.start()) + 1
