# SPDX-License-Identifier: Apache-2.0
"""What is read is a regular file of a bounded size: no folder, no pipe, not 20 GB by mistake."""

from __future__ import annotations

import codecs
import hashlib
import stat
from pathlib import Path

from taccel_lab.errors import InputError

LARGEST_BYTES = 8 << 30
"""More than an hour of video."""
_CHUNK_BYTES = 1 << 20


def require_regular_file(path: Path, limit_bytes: int, what: str) -> Path:
    """``path``, if a regular file of at most ``limit_bytes`` lies there that can be read.

    Args:
        path: The file.
        limit_bytes: Size that is allowed.
        what: What the file should be, with its article: "an image".

    Raises InputError with the path otherwise. Emptiness is for the format's reader to judge.
    """
    path = Path(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{path} is a folder; expected {what}, which is a file")
        if not stat.S_ISREG(status.st_mode):  # To open a pipe would wait for ever.
            raise InputError(f"{path} is no regular file but a pipe, a socket or a device")
        path.open("rb").close()
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; expected {what}") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name.
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InputError(f"{path} cannot be read: {why}") from None
    if status.st_size > limit_bytes:
        raise InputError(
            f"{path} has {in_bytes(status.st_size)}; {what} may have up to {in_bytes(limit_bytes)}"
        )
    return path


def read_regular_file(path: Path, limit_bytes: int, what: str) -> bytes:
    """Content of the file; the arguments and errors of :func:`require_regular_file`."""
    path = require_regular_file(path, limit_bytes, what)
    try:
        with path.open("rb") as file:
            content = file.read(limit_bytes + 1)
    except OSError as error:  # A file that has just been deleted, too.
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    if len(content) > limit_bytes:  # It grew, or it is a file of /proc, which have no size.
        raise InputError(f"{path} has more than {in_bytes(limit_bytes)}, the most for {what}")
    return content


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal; errors as of :func:`require_regular_file`."""
    digest = hashlib.sha256()
    path = require_regular_file(path, LARGEST_BYTES, "a file of a capture")
    try:
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK_BYTES):
                digest.update(chunk)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    return digest.hexdigest()


def in_bytes(count: float) -> str:
    """A size as a reader likes it: "3.1 GiB"."""
    for unit in ("bytes", "KiB", "MiB"):
        if count < 1024:
            return f"{count:.3g} {unit}" if unit != "bytes" else f"{count:.0f} bytes"
        count /= 1024
    return f"{count:.4g} GiB"


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
