# SPDX-License-Identifier: Apache-2.0
"""Triangles of 3MF files, read by lib3mf, which unpacks and builds whatever they state.

The format: 3MF Core Specification 1.3 (3MF Consortium), a zip of XML files.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.declared import require_few_copies
from taccel_lab.files.zip_sizes import read_members, require_small, require_small_directory

MAX_UNPACKED_BYTES = 96 << 20
"""Twice what 500,000 triangles take."""
_MM_PER_UNIT = {
    "MicroMeter": 1e-3, "MilliMeter": 1.0, "CentiMeter": 10.0, "Inch": 25.4, "Foot": 304.8,
    "Meter": 1e3,
}  # fmt: skip
"""Lengths of lib3mf's units [mm]."""
_MODEL = ".model"
_ELEMENT = re.compile(rb"<(?:[\w.-]+:)?(object|component|item|triangles)\b([^>]*)>")
_NUMBER = re.compile(rb"""\b(?:object)?id\s*=\s*["']\s*(\d+)""")
_TRIANGLE = re.compile(rb"<(?:[\w.-]+:)?triangle\b")


def read_package(path: Path, most: int) -> tuple[np.ndarray, np.ndarray]:
    """All that the file builds, where it puts it: points [mm], [n, 3], and triangles, [m, 3].

    For code that runs in the readers' process. Raises InputError for a file that cannot be read,
    unpacks to more than ``MAX_UNPACKED_BYTES``, or shows more than ``most`` triangles, those of a
    part that is built several times counted as often.
    """
    _check(path, most)
    from lib3mf import Lib3MF

    model: Any = Lib3MF.Wrapper().CreateModel()
    try:
        model.QueryReader("3mf").ReadFromFile(str(path))
        merged = model.MergeToModel()
    except Lib3MF.ELib3MFException as error:
        raise InputError(f"{path} is not a 3MF file that lib3mf can read ({error})") from None
    scale = _MM_PER_UNIT[model.GetUnit().name]
    points, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    objects = merged.GetMeshObjects()
    while objects.MoveNext():
        mesh = objects.GetCurrentMeshObject()
        corners = np.array([tuple(v.Coordinates) for v in mesh.GetVertices()])
        points.append(scale * corners.reshape(-1, 3))
        indices = np.array([tuple(t.Indices) for t in mesh.GetTriangleIndices()], dtype=np.int64)
        faces.append(indices.reshape(-1, 3) + count)
        count += len(corners)
    return np.concatenate(points), np.concatenate(faces)


def _check(path: Path, most: int) -> None:
    """Refuse what lib3mf would unpack or build for minutes."""
    parts: dict[Hashable, list[Hashable]] = {}
    triangles: dict[Hashable, int] = {}
    built: list[Hashable] = []
    try:
        with path.open("rb") as file:
            try:
                require_small_directory(file)
            except InputError as error:
                raise InputError(f"is no 3MF file: {error}") from None
            with zipfile.ZipFile(file) as archive:
                require_small(archive.infolist(), MAX_UNPACKED_BYTES, "a 3MF file")
                for name, content in read_members(archive):
                    if name.lower().endswith(_MODEL):
                        _collect(content, parts, triangles, built)
    except InputError as error:
        raise InputError(f"{path} {error}") from None
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise InputError(f"{path} is no 3MF file that can be read: {error}") from None
    require_few_copies(path, parts, built, most, own=triangles, what="triangles")


def _collect(
    content: bytes,
    parts: dict[Hashable, list[Hashable]],
    triangles: dict[Hashable, int],
    built: list[Hashable],
) -> None:
    """Objects of a model by number, what they are made of, and which of them are built. Numbers of
    several models may be equal: they count together, which is never less."""
    name: Hashable = None
    for element in _ELEMENT.finditer(content):
        found = _NUMBER.search(element[2])
        number = int(found[1][:20]) if found else None
        if element[1] == b"object":
            name = number
            parts.setdefault(name, [])
        elif element[1] == b"component":
            parts.setdefault(name, []).append(number)
        elif element[1] == b"item":
            built.append(number)
        else:
            end = content.find(b"triangles>", element.end())
            count = len(
                _TRIANGLE.findall(content, element.end(), end if end >= 0 else len(content))
            )
            triangles[name] = triangles.get(name, 1) + count
