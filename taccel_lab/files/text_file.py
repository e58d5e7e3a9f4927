# SPDX-License-Identifier: Apache-2.0
"""Text files: UTF-8, with or without a byte order mark, without NUL; and text that can be shown."""

from __future__ import annotations

import codecs
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import read_regular_file

SHOWN_CHARACTERS = 80
"""Most characters of a value that an error message quotes; a damaged file may hold one of
megabytes."""


def read_text(path: Path, limit_bytes: int, what: str, *, latin_1: bool = False) -> str:
    """Text of the file.

    Args:
        path: The file.
        limit_bytes: Size that is allowed.
        what: What the file should be, with its article: "a TOML file".
        latin_1: Take bytes that are not UTF-8 as Latin-1, which any bytes are: for tables of old
            programs, whose numbers are ASCII and where comments and file names alone can suffer.

    Raises InputError with the path: no regular file, too large, or no text.
    """
    data = read_regular_file(path, limit_bytes, what)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(f"{path} is UTF-16 text; save it as UTF-8")
    if b"\0" in data:
        line = _line(data, data.index(b"\0"))
        raise InputError(f"{path} has a NUL byte in line {line}: it is no text, or damaged")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if latin_1:
            return data.decode("latin-1")
        # `start` counts from behind a byte order mark.
        at = error.start + (len(codecs.BOM_UTF8) if data.startswith(codecs.BOM_UTF8) else 0)
        raise InputError(
            f"{path} is not UTF-8 text: byte 0x{data[at]:02x} in line {_line(data, at)}; save it "
            "as UTF-8"
        ) from None


def shown(value: object) -> str:
    """A value found in a file as a message quotes it, cut to 80 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no whole number of more than 4,300 digits.
        text = "a number of thousands of digits"
    return text if len(text) <= SHOWN_CHARACTERS else text[: SHOWN_CHARACTERS - 4] + " ..."


def _line(data: bytes, at: int) -> int:
    return data.count(b"\n", 0, at) + 1
