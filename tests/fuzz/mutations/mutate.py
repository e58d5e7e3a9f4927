# SPDX-License-Identifier: Apache-2.0
"""One to three mutations of the files of a folder, all drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from tests.fuzz.mutations import (
    array_level,
    byte_level,
    counts,
    folder_level,
    picture_level,
    text_level,
)
from tests.fuzz.mutations.draw import Draw, Surroundings

Mutator = Callable[[bytes, Draw, Surroundings], bytes]
_ALIASES = {".yml": ".yaml", ".jpeg": ".jpg", ".stp": ".step"}
OF_A_FORMAT: dict[str, tuple[Mutator, ...]] = {
    **text_level.MUTATORS,
    **array_level.MUTATORS,
    **picture_level.MUTATORS,
}
"""Mutators that know a format, by suffix."""
_FOLDER_SHARE, _BYTES_SHARE = 0.12, 0.3


def mutate(
    root: Path,
    names: Sequence[str],
    draw: Draw,
    outside: Path,
    seal: Callable[[Path], None] | None = None,
    *,
    larger_counts: bool = False,
) -> str:
    """Damage some of the files ``names`` of ``root``; returns what was done, in words.

    ``seal`` mends what says that a file is unchanged, such as a hash, so that readers go on.
    ``larger_counts``: whether counts and sizes are made larger, and nothing else is done.
    """
    words = []
    for _ in range(1 if draw.chance(0.7) else 2 + draw.below(2)):
        present = [name for name in names if _plain(root / name)]
        if not present:
            break
        name = draw.pick(present)
        path = root / name
        if larger_counts:
            change = draw.pick(counts.MUTATORS)
            path.write_bytes(change(path.read_bytes(), draw, Surroundings(outside)))
        elif draw.chance(_FOLDER_SHARE):
            change = draw.pick(folder_level.MUTATORS)
            change(path, draw, Surroundings(outside))
        else:
            change = draw.pick(_mutators(name, draw))
            others = tuple((root / other).read_bytes() for other in present if other != name)
            data = change(path.read_bytes(), draw, Surroundings(outside, others))
            path.write_bytes(data)
        words.append(f"{name}: {change.__name__}")
    if seal is not None and draw.chance(0.85):
        seal(root)
        words.append("sealed")
    return ", ".join(words)


def _mutators(name: str, draw: Draw) -> Sequence[Mutator]:
    suffix = PurePosixPath(name).suffix.lower()
    known = OF_A_FORMAT.get(_ALIASES.get(suffix, suffix))
    return byte_level.MUTATORS if known is None or draw.chance(_BYTES_SHARE) else known


def _plain(path: Path) -> bool:
    """A file of a size that can be taken into memory."""
    return not path.is_symlink() and path.is_file() and path.stat().st_size < 1 << 26
