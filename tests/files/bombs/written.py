# SPDX-License-Identifier: Apache-2.0
"""Files of a few parts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

Make = Callable[[Path], Path]
"""Writes a file into a folder."""


def written(name: str, *parts: str | bytes) -> Make:
    """A file of these parts."""

    def make(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(b"".join(p.encode() if isinstance(p, str) else p for p in parts))
        return path

    return make
