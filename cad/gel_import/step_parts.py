# SPDX-License-Identifier: Apache-2.0
"""How many parts a STEP file places, counted in its text: the CAD kernel visits each of them.

Entities: ISO 10303-44 (occurrences in assemblies) and 10303-43 (mapped items).
"""

from __future__ import annotations

import re
from collections.abc import Hashable
from pathlib import Path

from taccel_lab.files.declared import require_few_copies
from taccel_lab.files.regular_file import read_regular_file

MAX_BYTES = 50 << 20
"""Limit of a STEP file: a hundred times the largest of the sensors that we know, whose 271 faces
take 0.5 MiB; the CAD kernel needs some 30 times the size of a file."""
MAX_PARTS = 1_000
"""Bodies and assemblies of a file, each counted as often as it is placed: of a sensor that is
assembled with its housing, screws and all."""
_ENTITY = re.compile(
    rb"#(\d+)\s*=\s*(NEXT_ASSEMBLY_USAGE_OCCURRENCE|MAPPED_ITEM|REPRESENTATION_MAP"
    rb"|\w*SHAPE_REPRESENTATION)\s*\(([^;]*);"
)
_REFERENCE = re.compile(rb"#(\d+)")


def require_step_file(path: Path) -> Path:
    """``path``, if a file lies there that the kernel may meet.

    Raises InputError for one that is too large, and for assemblies of assemblies that place more
    than ``MAX_PARTS``.
    """
    content = read_regular_file(path, MAX_BYTES, "a STEP file")
    parts: dict[Hashable, list[Hashable]] = {}
    placed: set[Hashable] = set()
    for number, kind, rest in _ENTITY.findall(content):
        names = _REFERENCE.findall(rest)
        if kind == b"NEXT_ASSEMBLY_USAGE_OCCURRENCE":
            parts.setdefault(b"".join(names[:1]), []).extend(names[1:2])
            placed.update(names[1:2])
        else:
            # A mapped item is of a map, a map of a representation, that one of what it lists.
            parts[number] = names[:1] if kind == b"MAPPED_ITEM" else names
            placed.update([number] if kind == b"MAPPED_ITEM" else [])
    inner = {name for names in parts.values() for name in names}
    roots = [name for name in parts if name not in inner]
    own = {name: int(name in placed) for name in (*parts, *inner)}
    require_few_copies(path, parts, roots, MAX_PARTS, own=own)
    return path
