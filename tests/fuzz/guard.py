# SPDX-License-Identifier: Apache-2.0
"""A folder that a reader is watched in: nothing but its output may change, or appear."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
from pathlib import Path

SECRET_WORD = "kept_elsewhere"
SECRET = f"{SECRET_WORD} = 1 # what no reader has any business with\n".encode()
_HASHED = 1 << 20
"""Larger files are told apart by size and time."""


class Guard:
    """Folders ``given`` (input), ``made/out`` (output), and others that stay as they are."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.given, self.out = root / "given", root / "made" / "out"
        self.outside = root / "beside" / "outside.png"
        self.temporary, self.here = root / "temporary", root / "here"

    def prepare(self) -> None:
        """Everything anew but what is there already and harmless: the folders and the bait."""
        for folder in (self.given, self.root / "made"):
            remove(folder)
            folder.mkdir(parents=True)
        for folder in (self.outside.parent, self.temporary, self.here):
            folder.mkdir(exist_ok=True)
        for bait in (self.outside, self.root / "x", self.root / "x.png", self.root / "made" / "x"):
            bait.write_bytes(SECRET)

    def listing(self, own: Path | None = None) -> dict[str, str]:
        """Kind and content of all that is below, without the output and the folder ``own``."""
        found = {}
        left_out = {os.fsencode(path) for path in (self.out, own) if path is not None}
        for folder, folders, files in os.walk(os.fsencode(self.root)):
            folders[:] = [n for n in folders if os.path.join(folder, n) not in left_out]
            for name in (*folders, *files):
                path = os.path.join(folder, name)
                found[os.fsdecode(os.path.relpath(path, os.fsencode(self.root)))] = _state(path)
        return found

    def copied_secrets(self) -> list[str]:
        """Files of the output that hold what lies outside of the input."""
        found = []
        for folder, _, files in os.walk(self.out):
            for name in files:
                path = Path(folder, name)
                if path.is_file() and path.stat().st_size < _HASHED and SECRET in path.read_bytes():
                    found.append(name)
        return found


def changes(before: dict[str, str], after: dict[str, str]) -> list[str]:
    """In words, what is there, gone or otherwise."""
    new = [f"{name} appeared" for name in sorted(after.keys() - before.keys())]
    gone = [f"{name} vanished" for name in sorted(before.keys() - after.keys())]
    other = [f"{n} changed" for n in sorted(before.keys() & after.keys()) if before[n] != after[n]]
    return [*new, *gone, *other]


def remove(path: Path) -> None:
    """A folder with whatever is in it, names that are no text too."""
    if path.is_symlink() or path.is_file():
        path.unlink()
    elif path.exists():
        shutil.rmtree(os.fsencode(path))


def _state(path: bytes) -> str:
    about = os.lstat(path)
    if stat.S_ISLNK(about.st_mode):
        return "link to " + os.fsdecode(os.readlink(path))
    if not stat.S_ISREG(about.st_mode):
        return oct(stat.S_IFMT(about.st_mode))
    if about.st_size > _HASHED:
        return f"{about.st_size} bytes of {about.st_mtime_ns}"
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()
