# SPDX-License-Identifier: Apache-2.0
"""Where paths lead; and what a file names lies in its own folder, or is refused.

A manifest may come from anybody. Read and copied are only files in its folder, and nothing is ever
written by a name of its choice outside of the output.
"""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath, PureWindowsPath

from taccel_lab.errors import InputError

WHOLES = {
    "profile.toml": ("profile", b"\n[sensor]"),
    "dataset.json": ("data set", b'"taccel-lab data set"'),
    ".taccel_lab_study": ("study", b""),
}
"""Folders that no other output may lie in, as it would become a part of them, by the file that they
are known by: what they are, and what that file says, since others name files like this too. They
grow by their own commands alone."""
_LOOKED_AT = 1 << 16


def real_path(path: Path | str) -> Path:
    """Where ``path`` leads: absolute, links followed.

    A circle of links leads to one of them, where no file is found; ``Path.resolve`` raises, each
    version of Python something else. Raises InputError for a name that no file can have.
    """
    try:
        _require_possible(str(path))
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return Path(os.path.realpath(path))


def require_outside(target: Path | str) -> None:
    """Refuse an output inside a profile, a data set or a study: it would change what that
    folder means. The folder itself is its own commands' to go on with."""
    for folder in real_path(target).parents:
        for sign, (what, says) in WHOLES.items():
            if _says(folder / sign, says):
                raise InputError(
                    f"{target} lies inside the {what} {folder}; name a folder beside it"
                )


def _says(path: Path, words: bytes) -> bool:
    """Whether a file is there and has these words near its beginning; as good as, where it may not
    be read."""
    if not os.path.isfile(path):
        return False
    try:
        with open(path, "rb") as file:
            return words in file.read(_LOOKED_AT)
    except OSError:
        return True


def _require_possible(name: str) -> None:
    """ValueError for a name that no file has."""
    if "\0" in name:
        raise ValueError("a file name has no NUL in it")
    try:
        os.fsencode(name)
    except UnicodeEncodeError as error:
        wrong = error.object[error.start]
        raise ValueError(f"this computer's file names cannot have {wrong!r}") from None


def require_inner_name(name: str) -> str:
    """``name``, if it is that of a file in a folder or its sub-folders; ValueError otherwise."""
    _require_possible(name)
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
    inside = real_path(path).is_relative_to(real_path(folder))
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass  # Whether a file has to be there is for the caller to say.
    except OSError as error:  # A circle of links, too long a name, a folder that may not be read.
        raise InputError(f"{path} cannot be followed: {error.strerror}") from None
    if not inside:
        raise InputError(f"{path} is a link out of {folder}; put the file itself there")
    return path
