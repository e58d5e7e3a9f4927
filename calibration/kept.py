# SPDX-License-Identifier: Apache-2.0
"""Results that are slow to make, in files of the cache folder."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from taccel_lab.errors import InputError
from taccel_lab.output import CACHE_VARIABLE

Result = TypeVar("Result")


def read_kept(path: Path, read: Callable[[Path], Result], what: str) -> Result | None:
    """What ``read`` makes of a file; None without one, or with a warning when it is damaged.

    ``what`` names such results, in the plural. ``read`` raises ValueError or KeyError on a file
    that holds something else.
    """
    if not path.exists():
        return None
    try:
        return read(path)
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        warnings.warn(f"kept {what} {path} are damaged ({error}): made again", stacklevel=3)
        return None


def write_kept(path: Path, write: Callable[[Path], None], what: str) -> None:
    """Have ``write`` make the file.

    Raises:
        InputError: The cache folder cannot be written.
    """
    try:
        write(path)
    except OSError as error:
        raise InputError(
            f"cannot write the cache of {what} {path.parent} ({error.strerror}); set "
            f"{CACHE_VARIABLE} to a folder that can be written"
        ) from error
