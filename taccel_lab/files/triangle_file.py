# SPDX-License-Identifier: Apache-2.0
"""Triangle surfaces of other programs, read in a process of their own: STL, PLY and OBJ by VTK, 3MF
by lib3mf, which unpacks and builds whatever a file states.

3MF: Core Specification 1.3 (3MF Consortium), a zip of XML files.
"""

from __future__ import annotations

import os
import re
import warnings
import zipfile
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError, InputWarning
from taccel_lab.files.apart import read_apart
from taccel_lab.files.declared import (
    read_members,
    require_few,
    require_few_copies,
    require_small,
    require_small_directory,
)
from taccel_lab.files.regular_file import require_regular_file
from taccel_lab.files.vtk_mesh import read_vtk

SUFFIXES = (".stl", ".ply", ".obj", ".3mf")
MAX_TRIANGLES = 500_000
"""Most triangles of a surface; scans that are to be touched have a tenth of it, and contact with
more is slow."""
MAX_BYTES = 150 << 20
"""Bytes of as many triangles in the format that takes the most for each: STL as text, 300 bytes."""
FLAT = 1e-10
"""Twice the area of a triangle over its longest edge squared, up to which it has none."""
MAX_CORNERS = 5_000
"""Most corners of a face: the time to cut one into triangles grows with the square."""
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""A triangle of a binary STL file."""
_PLY_HEAD_BYTES = 1 << 16
"""Where the header of a PLY file ends, some 400 bytes as a rule."""


def read_triangle_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points in the unit of the file, of 3MF in millimetres, float64, [n, 3], and triangles, int64,
    [m, 3].

    Faces of more corners are cut into triangles, points at the same place merged, and triangles
    without area that this leaves, such as those between two equal points, go, and so do those of
    ``without_idle_faces``. Nothing is said of the surface: it may be open, or cross itself. The
    format is that of the name's ending, or, where it has none of ours, of the file that a link
    leads to.

    Raises InputError for a file that cannot be read, has no faces, more than ``MAX_TRIANGLES``, or
    coordinates that are not finite.
    """
    require_regular_file(path, MAX_BYTES, "a triangle mesh (STL, PLY, OBJ or 3MF)")
    names = (path, Path(os.path.realpath(path)))
    suffix = next((name.suffix.lower() for name in names if name.suffix.lower() in SUFFIXES), None)
    if suffix is None:
        raise InputError(f"{path}: only .stl, .ply, .obj and .3mf files can be read as triangles")
    if suffix == ".ply":
        _check_ply_counts(path)
    if suffix == ".stl":
        _check_stl_numbers(path)
    if suffix == ".3mf":
        points, faces = read_apart(str(path), _read_package, path, by="lib3mf")
    else:
        points, faces = read_apart(str(path), _read_with_vtk, path, suffix, by="vtkmodules")
    if not len(faces):
        raise InputError(f"{path} holds no faces, or is not a readable mesh file")
    return without_idle_faces(path, points, faces)


def without_idle_faces(
    path: Path, points: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same surface without triangles that have no area or stand there twice, and with a
    warning, where its edges meet better without them: programs leave some behind in closed
    surfaces. Points of no face go, too."""
    corners = points[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = np.linalg.norm(crosses, axis=1) <= FLAT * longest**2
    # Each from its smallest corner on, so that those that look the same way are equal.
    turned = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    first = np.unique(np.take_along_axis(faces, turned, axis=1), axis=0, return_index=True)[1]
    twice = np.ones(len(faces), dtype=bool)
    twice[first] = False
    for idle in (flat | twice, twice):
        kept = faces[~idle]
        if not (idle.any() and len(kept)) or _loose_edges(kept) >= _loose_edges(faces):
            continue
        warnings.warn(
            f"{path}: {idle.sum()} of {len(faces)} triangles have no area or stand there twice; "
            "they are left out",
            InputWarning,
            stacklevel=3,
        )
        used, kept = np.unique(kept, return_inverse=True)
        return points[used], kept.reshape(-1, 3)
    return points, faces


def _loose_edges(faces: np.ndarray) -> int:
    """Edges that are not of two faces."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return int((np.unique(edges, axis=0, return_counts=True)[1] != 2).sum())


def _read_with_vtk(path: Path, suffix: str) -> tuple[np.ndarray, np.ndarray]:
    """What VTK makes of the file; runs in the readers' process."""
    import pyvista

    loaded = read_vtk(path, suffix)
    if not isinstance(loaded, pyvista.PolyData) or loaded.n_cells == 0 or loaded.n_points == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    return _cleaned(path, loaded)


def _read_package(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Its triangles cleaned; runs in the readers' process."""
    points, faces = read_package(path, MAX_TRIANGLES)
    return clean_triangles(path, points, faces) if len(faces) else (points, faces)


def clean_triangles(
    path: Path, points: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points [n, 3] and triangles [m, 3] that were read of a file as ``read_triangle_file`` gives
    them."""
    import pyvista

    check_count(path, len(faces))
    return _cleaned(path, pyvista.PolyData.from_regular_faces(points, faces))


def _cleaned(path: Path, loaded: Any) -> tuple[np.ndarray, np.ndarray]:
    # The filters follow an index wherever it points, and order points by coordinates.
    _check_numbers(path, loaded.points, loaded.GetPolys())
    corners = loaded.GetPolys().GetMaxCellSize()
    require_few(path, "corners of a face", corners, MAX_CORNERS, "cut it")
    check_count(
        path,
        loaded.GetPolys().GetNumberOfConnectivityIds() - 2 * loaded.GetPolys().GetNumberOfCells(),
    )
    surface = loaded.triangulate().clean()
    assert surface is not None  # As it is for a filter in place only.
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, 1:]
    check_count(path, len(faces))
    return np.asarray(surface.points, dtype=np.float64), faces.astype(np.int64)


def _check_ply_counts(path: Path) -> None:
    """Refuse counts that the file cannot hold, for which VTK would take memory first."""
    with path.open("rb") as file:
        head, end, _ = file.read(_PLY_HEAD_BYTES).partition(b"end_header")
    if head.startswith(b"ply") and not end:
        raise InputError(
            f"{path} has no header that ends within {_PLY_HEAD_BYTES >> 10} KiB; it is damaged"
        )
    size = path.stat().st_size
    for name, digits in re.findall(rb"^element\s+(\S+)\s+(\d+)", head if end else b"", re.M):
        # The shortest item takes a byte. More digits than that are no count either.
        count = int(digits) if len(digits) < 20 else size + 1
        if count > size:
            raise InputError(
                f"{path} says that it has {digits[:20].decode()} items "
                f"{name.decode('ascii', 'replace')!r}, but it has {size:,} bytes; it is damaged"
            )
        if name == b"face":
            check_count(path, count)


def _check_stl_numbers(path: Path) -> None:
    """Refuse NaN in a binary file, of which VTK makes an empty surface."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else 0
    if not count or len(data) != 84 + _STL.itemsize * count:
        return
    corners = np.frombuffer(data, dtype=_STL, offset=84)["corners"]
    bad = np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))
    if len(bad):
        raise InputError(
            f"{path}: {len(bad)} of {count} triangles have NaN or infinite coordinates (the first "
            f"is triangle {bad[0]})"
        )


def check_count(path: Path, count: int) -> None:
    require_few(path, "faces", count, MAX_TRIANGLES, "simplify it")


def _check_numbers(path: Path, points: np.ndarray, polygons: object) -> None:
    from vtkmodules.util.numpy_support import vtk_to_numpy

    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise InputError(
            f"{path}: {len(bad)} of {len(points)} points have NaN or infinite coordinates "
            f"(the first is point {bad[0]})"
        )
    corners = vtk_to_numpy(polygons.GetConnectivityArray())  # type: ignore[attr-defined]
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        raise InputError(
            f"{path}: its faces name points {corners.min()} to {corners.max()}, but it has points "
            f"0 to {len(points) - 1}"
        )


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
