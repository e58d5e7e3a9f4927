# SPDX-License-Identifier: Apache-2.0
"""Paths that come out of files: what a file names lies in its own folder, or is refused.

A manifest may come from anybody. Read and copied are only files in its folder, and nothing is ever
written by a name of its choice outside of the output.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath

from taccel_lab.errors import InputError


def require_inner_name(name: str) -> str:
    """``name``, if it is that of a file in a folder or its sub-folders; ValueError otherwise."""
    if "\0" in name:
        raise ValueError("a file name has no NUL in it")
    if PurePosixPath(name).is_absolute() or PureWindowsPath(name).anchor:
        raise ValueError("a file is named relative to the folder, not by an absolute path")
    if ".." in PurePosixPath(name).parts or ".." in PureWindowsPath(name).parts:
        raise ValueError("a file has to lie in the folder; '..' leads out of it")
    return name


def inner_path(folder: Path, name: str) -> Path:
    """Path of the file ``name`` of ``folder``; links that lead out of the folder are refused.

    Raises InputError with the path.
    """
    try:
        path = folder / require_inner_name(name)
    except ValueError as error:
        raise InputError(f"{folder}: {name!r}: {error}") from None
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
        path.exists()  # Raises for a name that is too long, or a folder that may not be read.
    except UnicodeEncodeError as error:
        reason = f"this computer's file names cannot have {error.object[error.start]!r}"
        raise InputError(f"{folder}: {name!r}: {reason}") from None
    except (OSError, RuntimeError) as error:  # A circle of links.
        raise InputError(f"{path} cannot be followed: {error}") from None
    if not inside:
        raise InputError(f"{path} is a link out of {folder}; put the file itself there")
    return path
