# SPDX-License-Identifier: Apache-2.0
"""The marker of a folder that a command wrote: which files, with a digest and a size of each."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_json
from taccel_lab.files.inner_path import entries_below, require_inner_name

OUTPUT_MARKER = ".taccel_lab_output"
"""Name of a file in every folder that a command wrote: SHA-256 and size of each of its files, by
name, as JSON."""
DESKTOP_FILES = {".DS_Store", "Thumbs.db", "desktop.ini"}
"""What file browsers leave behind in folders that are looked at."""
_EMPTY = hashlib.sha256(b"").hexdigest()
MOST_SHOWN = 3
"""Files that a refusal names."""


def _digest(path: Path) -> str:
    if path.is_symlink():
        return "link to " + os.readlink(path)
    if path.is_dir():
        return "empty folder"
    if not path.is_file():  # To open a pipe would wait for ever.
        return "no regular file"
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def marked_files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Every file, link and empty folder below ``folder`` but the marker, with its name from
    there."""
    return (entry for entry in entries_below(folder) if entry[0] != OUTPUT_MARKER)


def write_marker(folder: Path) -> None:
    files = sorted(marked_files(folder))
    digests = {name: _digest(path) for name, path in files}
    sizes = {name: path.stat().st_size for name, path in files if path.is_file()}
    text = json.dumps({"files": digests, "bytes": sizes}, indent=1)
    (folder / OUTPUT_MARKER).write_text(text + "\n", encoding="utf-8")


def read_marker(folder: Path) -> dict[str, str]:
    """Digest of each file that was written; empty where there is no sound marker: one that names
    files outside the folder is not of our making."""
    return _marker(folder)[0]


def _marker(folder: Path) -> tuple[dict[str, str], dict[str, int]]:
    """Digests and sizes by name; earlier versions kept no sizes."""
    try:
        found = read_json(folder / OUTPUT_MARKER)
        files, sizes = found.get("files"), found.get("bytes")
        for name in files if isinstance(files, dict) else ():
            require_inner_name(name)
    # ValueError: such a name. FileNotFoundError: it vanished while it was read.
    except (InputError, ValueError, FileNotFoundError):
        return {}, {}
    return (
        files if isinstance(files, dict) else {},
        sizes if isinstance(sizes, dict) else {},
    )


def foreign_files(folder: Path) -> list[str]:
    """Files that no command wrote, or that were changed since: the first ones found."""
    written, sizes = _marker(folder)
    found = []
    for name, path in marked_files(folder):
        if path.name in DESKTOP_FILES:
            continue
        # What vanishes meanwhile was an earlier output that another process clears away.
        with suppress(FileNotFoundError):
            # A file of another size need not be read.
            size = path.lstat().st_size if path.is_file() and not path.is_symlink() else None
            known = name in written and (size is None or sizes.get(name, size) == size)
            if not known or written[name] != _digest(path):
                found.append(name)
        if len(found) > MOST_SHOWN:
            break
    return found


def visible_faults(folder: Path) -> list[str]:
    """What one look at an output tells of its files, none of which is read: those that are missing,
    or have another size than when they were written. Earlier versions kept no sizes; of theirs,
    files that are empty now.

    Raises InputError where the folder has no sound marker; OSError for what cannot be looked at.
    """
    written, sizes = _marker(folder)
    if not written:
        raise InputError(f"{folder} has no list of its files, or a damaged one ({OUTPUT_MARKER})")
    faults = []
    for name in written:
        kept = sizes.get(name)
        try:
            status = (folder / name).lstat()
        except (FileNotFoundError, NotADirectoryError):
            faults.append(f"{name} is missing")
            continue
        if kept is not None and status.st_size != kept:
            faults.append(f"{name} has {status.st_size} bytes of {kept}")
        elif stat.S_ISREG(status.st_mode) and status.st_size == 0 and written[name] != _EMPTY:
            faults.append(f"{name} is empty")
    return faults
