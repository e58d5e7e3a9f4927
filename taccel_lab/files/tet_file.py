# SPDX-License-Identifier: Apache-2.0
"""Tet meshes of other programs: Gmsh's .msh, VTK's .vtu and .vtk, read in a process of its own, or
with numpy alone where that does (``vtk_tets``).

MSH files of versions 2.2 and 4.1, as text or binary, are read with numpy alone. The format:
https://gmsh.info/doc/texinfo/gmsh.html#Gmsh-file-formats
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import read_apart
from taccel_lab.files.declared import require_few
from taccel_lab.files.regular_file import read_regular_file, require_regular_file
from taccel_lab.files.vtk_mesh import QUADRATIC_TETRA, TETRA, cells_of, read_vtk
from taccel_lab.files.vtk_tets import plain_tets

SUFFIXES = (".msh", ".vtu", ".vtk")
MAX_TETS = 500_000
"""Most tetrahedra of a gel; those of the catalogue have a tenth of it."""


def read_tet_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in the unit of the file, float64, [n, 3], and tets of no negative volume, int64,
    [t, 4].

    Nodes that no tet has are left out, and so are cells of other kinds. Tets of the second order
    keep their corners. Raises InputError for a file that cannot be read, has no tets or too many,
    and for coordinates that are not finite.
    """
    what = "a tet mesh (.msh, .vtu or .vtk)"
    require_regular_file(path, MAX_BYTES, what)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: only {', '.join(SUFFIXES)} files can be read as tets")
    if suffix == ".msh":
        nodes, tets = read_apart(str(path), read_gmsh, path, by="numpy")
    elif suffix != ".vtk" or (
        (plain := plain_tets(read_regular_file(path, MAX_BYTES, what))) is None
    ):
        nodes, tets = read_apart(str(path), _read_with_vtk, path, suffix, by="vtkmodules")
    else:
        nodes, tets = plain
    if not len(tets):
        raise InputError(f"{path} holds no tets, or is not a readable mesh file")
    require_few(path, "tets", len(tets), MAX_TETS, "coarsen it")
    if tets.min() < 0 or tets.max() >= len(nodes):
        raise InputError(f"{path} has tets of nodes that it does not have")
    bad = np.flatnonzero(~np.isfinite(nodes).all(axis=1))
    if len(bad):
        raise InputError(
            f"{path}: {len(bad)} of {len(nodes)} nodes have NaN or infinite coordinates "
            f"(the first is node {bad[0]})"
        )
    used, packed = np.unique(tets, return_inverse=True)
    nodes, tets = nodes[used], packed.reshape(-1, 4)
    corners = nodes[tets]
    with np.errstate(all="ignore"):  # Coordinates of 1e200 are for others to judge.
        inverted = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
    return nodes, tets


def _read_with_vtk(path: Path, suffix: str) -> tuple[np.ndarray, np.ndarray]:
    """What VTK makes of the file; runs in the readers' process."""
    import pyvista

    loaded = read_vtk(path, suffix)
    if not isinstance(loaded, pyvista.UnstructuredGrid) or not loaded.n_cells:
        return np.zeros((0, 3)), np.zeros((0, 4), np.int64)
    cells = cells_of(path, loaded)
    tets = [cells[kind][:, :4] for kind in (TETRA, QUADRATIC_TETRA) if kind in cells]
    found = np.concatenate(tets) if tets else np.zeros((0, 4), np.int64)
    return np.asarray(loaded.points, dtype=np.float64), found


MAX_BYTES = 150 << 20
"""A million tets as text."""
TETS = (4, 11)
"""Gmsh's numbers of tets with 4 and with 10 nodes, the corners first."""
_NODES = {1: 2, 2: 3, 3: 4, 4: 4, 5: 8, 6: 6, 7: 5, 8: 3, 9: 6, 10: 9, 11: 10, 15: 1, 16: 8}
"""Nodes of an element by Gmsh's number of its type."""
_BYTES = {"size": "<u8", "int": "<i4", "double": "<f8"}


def read_gmsh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in the unit of the file, float64, [n, 3], and the corners of its tets, int64, [t, 4],
    as they stand there; elements of other kinds are left out.

    Raises InputError for another version or a damaged file.
    """
    data = read_regular_file(path, MAX_BYTES, "a Gmsh file (.msh)")
    try:
        return _content(data)
    except InputError as error:
        raise InputError(f"{path} {error}") from None
    except (ValueError, OverflowError, IndexError):
        raise InputError(f"{path} is damaged: its numbers do not fit its counts") from None


def _content(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    words = _section(data, b"MeshFormat").split(maxsplit=3)
    if len(words) < 3:
        raise InputError("is no Gmsh file: it has no format")
    version, binary = words[0].decode("ascii", "replace"), words[1] == b"1"
    if version not in ("2.2", "4.1"):
        raise InputError(f"has version {version[:8]} of Gmsh's format; 2.2 and 4.1 can be read")
    if binary and words[3][:4] != b"\1\0\0\0":
        raise InputError("was written on a big-endian machine; save it as text")
    parts = [_section(data, name) for name in (b"Nodes", b"Elements")]
    if version == "4.1":
        tags, nodes = _nodes_4(_Numbers(parts[0], binary))
        corners = _tets_4(_Numbers(parts[1], binary))
    else:
        tags, nodes = _nodes_2(parts[0], binary)
        corners = _tets_2(parts[1], binary)
    if not len(corners):
        raise InputError("has no tets: mesh its volume in 3D before it is saved")
    order = np.argsort(tags, kind="stable")
    found = np.minimum(np.searchsorted(tags[order], corners), len(tags) - 1)
    tets = order[found]
    if (tags[tets] != corners).any():
        raise InputError("has tets of nodes that it does not have")
    return nodes, tets


def _section(data: bytes, name: bytes) -> bytes:
    begin, end = data.find(b"$" + name), data.find(b"$End" + name)
    if begin < 0 or end < 0:
        raise InputError(f"is no whole Gmsh file: the part ${name.decode()} is missing")
    return data[data.index(b"\n", begin) + 1 : end]


class _Numbers:
    """The numbers of a section one after the other, of text or of bytes."""

    def __init__(self, part: bytes, binary: bool) -> None:
        self._binary, self._at = binary, 0
        self._content = part if binary else np.array(part.split(), dtype=np.float64)

    def take(self, kind: Literal["size", "int", "double"], count: int) -> np.ndarray:
        """The next ``count`` of them: float64, or int64 of counts, tags and types."""
        width = 8 if kind != "int" else 4
        end = self._at + count * (width if self._binary else 1)
        if end > len(self._content):
            raise ValueError
        piece, self._at = self._content[self._at : end], end
        if isinstance(piece, bytes):
            piece = np.frombuffer(piece, dtype=_BYTES[kind])
        if kind == "double":
            return piece.astype(np.float64)
        return _whole(piece)


def _whole(numbers: np.ndarray) -> np.ndarray:
    """Tags, counts and types, int64; ValueError for what is none."""
    with np.errstate(invalid="ignore"):
        whole = numbers.astype(np.int64)
    if (whole != numbers).any() or (whole < -(2**31)).any():
        raise ValueError
    return whole


def _nodes_4(numbers: _Numbers) -> tuple[np.ndarray, np.ndarray]:
    tags, places = [], []
    for _ in range(int(numbers.take("size", 4)[0])):
        dimension, _, parametric = numbers.take("int", 3)
        count = int(numbers.take("size", 1)[0])
        tags.append(numbers.take("size", count))
        width = 3 + int(parametric) * int(dimension)
        places.append(numbers.take("double", count * width).reshape(count, width)[:, :3])
    if not places:
        raise InputError("has no nodes")
    return np.concatenate(tags), np.concatenate(places)


def _tets_4(numbers: _Numbers) -> np.ndarray:
    found = [np.zeros((0, 4), dtype=np.int64)]
    for _ in range(int(numbers.take("size", 4)[0])):
        kind = int(numbers.take("int", 3)[2])
        count, width = int(numbers.take("size", 1)[0]), 1 + _width(kind)
        block = numbers.take("size", count * width).reshape(count, width)
        if kind in TETS:
            found.append(block[:, 1:5])
    return np.concatenate(found)


def _nodes_2(part: bytes, binary: bool) -> tuple[np.ndarray, np.ndarray]:
    words, _, rest = part.partition(b"\n")
    count = int(words)
    if count < 1:
        raise ValueError
    if binary:
        table = np.frombuffer(rest, dtype=[("tag", "<i4"), ("at", "<f8", 3)], count=count)
        return table["tag"].astype(np.int64), table["at"].astype(np.float64)
    rows = np.array(rest.split(), dtype=np.float64).reshape(count, 4)
    return _whole(rows[:, 0]), np.ascontiguousarray(rows[:, 1:])


def _tets_2(part: bytes, binary: bool) -> np.ndarray:
    words, _, rest = part.partition(b"\n")
    left, at = int(words), 0
    found = [np.zeros((0, 4), dtype=np.int64)]
    if not binary:
        numbers = np.array(rest.split(), dtype=np.int64)
        for _ in range(left):
            kind, tags = int(numbers[at + 1]), int(numbers[at + 2])
            at += 3 + tags + _width(kind)
            if kind in TETS:
                first = at - _width(kind)
                found.append(numbers[first : first + 4][None])
        if at > len(numbers):
            raise ValueError
        return np.concatenate(found)
    while left > 0:
        kind, count, tags = np.frombuffer(rest, dtype="<i4", count=3, offset=at).tolist()
        width = 1 + tags + _width(kind)
        if count < 1 or tags < 0:
            raise ValueError
        block = np.frombuffer(rest, dtype="<i4", count=count * width, offset=at + 12)
        if kind in TETS:
            found.append(block.reshape(count, width)[:, 1 + tags : 5 + tags].astype(np.int64))
        at, left = at + 12 + 4 * count * width, left - count
    return np.concatenate(found)


def _width(kind: int) -> int:
    if kind not in _NODES:
        raise InputError(f"has elements of Gmsh's type {kind}; save tets of first or second order")
    return _NODES[kind]
