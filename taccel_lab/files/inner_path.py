# SPDX-License-Identifier: Apache-2.0
"""Where paths lead; and what a file names lies in its own folder, or is rejected.

A manifest, a data set or a study may come from anybody. Read, copied, written and deleted are only
files in its folder: no name and no link in it leads anywhere else.
"""

from __future__ import annotations

import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath, PureWindowsPath

from taccel_lab.errors import InputError
from taccel_lab.guards import unknown

WHOLES = {
    "profile.toml": ("profile", b"\n[sensor]"),
    "dataset.json": ("data set", b'"taccel-lab data set"'),
    ".taccel_lab_study": ("study", b""),
}
"""Folders that no other output may lie in, as it would become a part of them, by the file that they
are known by: what they are, and what that file says, since others name files like this too. They
grow by their own commands alone."""
_LOOKED_AT = 1 << 16
_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")
"""How an address begins; a single letter is a drive of Windows."""


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
    """Path of the file ``name`` of ``folder``; links that lead out of the folder are rejected.

    Raises InputError with the path.
    """
    try:
        path = folder / require_inner_name(name)
    except ValueError as error:
        raise InputError(f"{folder}: {name!r}: {error}") from None
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass  # Whether a file has to be there is for the caller to say.
    except OSError as error:  # A circle of links, too long a name, a folder that may not be read.
        raise InputError(f"{path} cannot be followed: {error.strerror}") from None
    if not real_path(path).is_relative_to(real_path(folder)):
        raise InputError(
            f"{path} is a link out of {folder}; put the file itself there: cp -rL makes a copy "
            "without links"
        )
    return path


def own_place(folder: Path, name: str) -> Path:
    """Path of the file ``name`` that is written into ``folder``, which stays; the folder itself may
    be reached by a link, nothing in it.

    Raises InputError for a link at the file or on the way to it: what it leads to is not to change.
    """
    path = inner_path(folder, name)
    for place in (path, *path.parents[: len(path.relative_to(folder).parts) - 1]):
        if place.is_symlink():
            raise InputError(f"{place} is a link; put the file itself there, to be written to")
    return path


def named_path(folder: Path, at: str, name: str) -> Path:
    """Path of what a file of ``folder`` names, counted from its sub-folder ``at``.

    Raises InputError, as :func:`inner_path`, for a name that leads out of ``folder``, and for an
    address such as ``https://...``.
    """
    if _ADDRESS.match(name):
        raise InputError(f"{folder}: {name!r}: a file is named by its path, not by an address")
    if not name or PurePosixPath(name).is_absolute():
        return inner_path(folder, name)
    # What is opened is the path without "..", so that a link on its way cannot turn it.
    return inner_path(folder, os.path.normpath(PurePosixPath(at, name)))


def entries_below(folder: Path, levels: int | None = None) -> Iterator[tuple[str, Path]]:
    """Every file, link and empty folder below ``folder``, with its name from there; no link is
    followed. ``levels``: how deep, 1 for what lies in the folder itself."""
    for root, folders, names in os.walk(folder):
        links = [name for name in folders if os.path.islink(os.path.join(root, name))]
        inner = Path(root).relative_to(folder)
        for name in sorted((*names, *links)):
            yield (inner / name).as_posix(), Path(root, name)
        if not names and not folders and inner.parts:
            yield inner.as_posix(), Path(root)
        if levels is not None and len(inner.parts) + 1 >= levels:
            folders.clear()


def inner_files(folder: Path, name: str = "", levels: int | None = None) -> Iterator[Path]:
    """The file ``name`` of ``folder``, or every file below the folder of that name; without one,
    below ``folder``, ``levels`` deep.

    Raises InputError for a link that leads out of ``folder`` or to no file, for what is neither
    file nor folder (to read a pipe would wait for ever, and a device has no end), and for a name
    that is not there.
    """
    start = inner_path(folder, name) if name else folder
    if not start.exists():
        raise InputError(f"{start} does not exist")
    paths = (path for _, path in entries_below(start, levels)) if start.is_dir() else [start]
    for path in paths:
        if path.is_symlink():
            _require_link_inside(path, folder)
        with suppress(FileNotFoundError):  # It vanished since: others may write here, too.
            kind = path.stat().st_mode
            if stat.S_ISREG(kind):
                yield path
            elif not stat.S_ISDIR(kind):
                raise InputError(f"{path} is no regular file but a pipe, a socket or a device")


def _require_link_inside(path: Path, folder: Path) -> None:
    inner_path(folder, path.relative_to(folder).as_posix())
    if not path.is_file():
        raise InputError(f"{path} is a link, and not to a file; put the file itself there")


def require_inner_links(folder: Path, levels: int | None = None) -> None:
    """Refuse a folder of somebody else in which a link leads out, before anything of it is read:
    what it leads to is no part of the folder, and none of our business. What is hidden, names that
    begin with a dot, no reader looks at. Errors of :func:`inner_path`, and ``levels`` as of
    :func:`entries_below`."""
    for name, path in entries_below(folder, levels):
        if path.is_symlink() and not any(part[0] == "." for part in name.split("/")):
            inner_path(folder, name)


def require_inner_files(folder: Path, levels: int | None = None) -> None:
    """Refuse a folder in which a command would read, write or delete something that lies elsewhere;
    errors and ``levels`` of :func:`inner_files`. An absent folder is fine."""
    if folder.is_dir():
        for _ in inner_files(folder, levels=levels):
            pass


def copy_inner(folder: Path, name: str, target: Path) -> None:
    """Copy the file or folder ``name`` of ``folder`` to the same name in ``target``; errors of
    :func:`inner_files`."""
    for path in inner_files(folder, name):
        copy = inner_path(target, path.relative_to(folder).as_posix())
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)


_PACKAGE = Path(__file__).parents[1]


def file_or_example(given: Path, room: str) -> Path:
    """``given`` where it is a file, else the example of that name.

    A folder does not hide an example: it may be the output of an earlier run.

    Args:
        given: A path, or an example's name with or without ``.toml``, alone or behind the folder
            where examples stand in a checkout.
        room: Package of the examples: ``studies`` or ``datasets``.

    Raises:
        InputError: Neither a file nor an example; lists the examples.
    """
    folders = ((), (room, "examples"), (_PACKAGE.name, room, "examples"))
    if given.is_file() or given.parts[:-1] not in folders or given.suffix not in ("", ".toml"):
        return given
    examples = _PACKAGE / room / "examples"
    found = examples / f"{given.stem}.toml"
    if not found.is_file():
        if given.exists():
            return given
        more = unknown(given.stem, sorted(path.stem for path in examples.glob("*.toml")))
        raise InputError(f"{given} does not exist, and no example has that name{more}")
    return found
