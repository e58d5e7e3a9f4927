# SPDX-License-Identifier: Apache-2.0
"""What a reader of files is to the suite: a sound sample, and how it is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path


class Refused(Exception):
    """A command that ended with exit code 2; the message is what it printed."""


@dataclass(frozen=True)
class Reader:
    """One way in for files."""

    make: Callable[[Path], None]
    """Writes a sound sample into an empty folder."""
    call: Callable[[Path, Path], object]
    """Reads the sample in the first folder; writes, if at all, the second, which is not there."""
    files: tuple[str, ...] = ("*",)
    """Patterns of the files that are damaged."""
    seal: Callable[[Path], None] | None = None
    """Makes hashes that a sample states those of the damaged files."""
    named: tuple[str, ...] = ()
    """Patterns of files that the user names: these may be links, and what they lead to is read."""
    counts: bool = False
    """Whether counts and sizes that its files state are made larger, and nothing else is done."""
    own: str | None = None
    """Folder of the sample, if any, that the reader may change: its own output of earlier."""

    def damages(self, name: str) -> bool:
        return any(fnmatch(name, pattern) for pattern in self.files)

    def may_be_link(self, name: str) -> bool:
        return any(fnmatch(name, pattern) for pattern in self.named)
