# SPDX-License-Identifier: Apache-2.0
"""What is read is a regular file of a bounded size: no folder, no pipe, not 20 GB by mistake."""

from __future__ import annotations

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
