# SPDX-License-Identifier: Apache-2.0
"""Whether a git clone knows files of a folder, by its index, without git.

A clone may be a stranger's: git would run what its configuration names. The index is a list of
paths (git's Documentation/gitformat-index, versions 2 to 4); whatever it holds besides is skipped.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import read_regular_file
from taccel_lab.files.text_file import read_text
from taccel_lab.printable import printable

_INDEX_BYTES = 256 << 20
_CONFIG_BYTES = 1 << 20
_FIXED = 40
"""Bytes of an entry before the object's name."""
_EXTENDED, _LENGTH = 0x4000, 0xFFF
"""Bits of an entry's flags: two further bytes follow; length of the path, or more than that."""


@dataclass(frozen=True)
class Clone:
    """A folder with a ``.git``."""

    root: Path

    @classmethod
    def around(cls, folder: Path) -> Clone | None:
        """The nearest one that ``folder`` is, or lies in."""
        found = next((p for p in (folder, *folder.parents) if (p / ".git").exists()), None)
        return None if found is None else cls(found)

    def tracks(self, files: list[Path]) -> bool:
        """Whether there are files, and each of them stands in the index."""
        try:
            known = self._indexed()
        except (InputError, ValueError, struct.error):
            return False
        return bool(files) and all(
            file.relative_to(self.root).as_posix().encode(errors="surrogateescape") in known
            for file in files
        )

    def remote(self) -> str | None:
        """Address of the remote ``origin``, without a user's name and password."""
        found = re.search(r'\[remote "origin"\][^\[]*?url\s*=\s*(\S+)', self._config())
        return None if found is None else re.sub(r"//[^/@]*@", "//", printable(found[1]))

    def _folder(self) -> Path:
        """Where git keeps the index: submodules and work trees name it in a file."""
        git = self.root / ".git"
        if git.is_dir():
            return git
        text = read_text(git, _CONFIG_BYTES, "the name of a git folder", latin_1=True)
        return self.root / text.removeprefix("gitdir:").strip()

    def _config(self) -> str:
        try:
            folder = self._folder()
            common = folder / "commondir"  # Of a work tree.
            if common.is_file():
                folder /= read_text(common, _CONFIG_BYTES, "the name of a git folder").strip()
            return read_text(folder / "config", _CONFIG_BYTES, "a text", latin_1=True)
        except InputError:
            return ""

    def _indexed(self) -> set[bytes]:
        """Paths of the index, below the root. Raises ValueError, or struct.error where it is cut
        short, for what is no index."""
        data = read_regular_file(self._folder() / "index", _INDEX_BYTES, "a git index")
        sign, version, count = struct.unpack_from(">4sII", data)
        if sign != b"DIRC" or version not in (2, 3, 4):
            raise ValueError("no index")
        hash_bytes = 32 if re.search(r"objectformat\s*=\s*sha256", self._config(), re.I) else 20
        paths: set[bytes] = set()
        place, path = 12, b""
        for _ in range(count):
            start, place = place, place + _FIXED + hash_bytes
            (flags,) = struct.unpack_from(">H", data, place)
            place += 4 if version > 2 and flags & _EXTENDED else 2
            kept = 0
            if version == 4:  # So many bytes of the path before are not of this one.
                dropped, place = _variable(data, place)
                kept = max(0, len(path) - dropped)
            end = data.index(b"\0", place)
            path = path[:kept] + data[place:end]
            if min(len(path), _LENGTH) != flags & _LENGTH:
                raise ValueError("no index")
            paths.add(path)
            # Up to version 3 one to eight bytes of 0 end an entry at a multiple of eight.
            place = end + 1 if version == 4 else start + (end - start + 8) // 8 * 8
        return paths


def _variable(data: bytes, place: int) -> tuple[int, int]:
    """A number of git's variable width, and the place behind it; as offsets in its packs."""
    value = data[place] & 0x7F
    while data[place] & 0x80:
        place += 1
        value = (value + 1) << 7 | data[place] & 0x7F
        if value > _INDEX_BYTES:
            raise ValueError("no index")
    return value, place + 1
