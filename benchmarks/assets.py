# SPDX-License-Identifier: Apache-2.0
"""Meshes of published examples, read with numpy alone: legacy VTK and binary STL files.

They lie in ``taccel_assets`` below the data folder, which is ``TACCEL_LAB_DATA``, or
``../shared/data`` beside a checkout; nothing in it is needed, since every scene can make meshes of
the same dimensions itself.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.scene import TriangleMesh

_TETRA = 10
_TYPES = {
    "float": ">f4",
    "double": ">f8",
    "int": ">i4",
    "vtktypeint64": ">i8",
    "vtktypeint32": ">i4",
}


def data_folder() -> Path:
    """Where published meshes and real captures are looked for."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("TACCEL_LAB_DATA", beside))


def mesh_folder() -> Path:
    """Where the published meshes are looked for."""
    return data_folder() / "taccel_assets"


def has_data(*parts: str) -> bool:
    """Whether these files or folders of ``mesh_folder`` are there."""
    return all((mesh_folder() / part).exists() for part in parts)


def choose_source(source: str, *parts: str) -> str:
    """ "published" or "generated": what was asked for, or, for "auto", what there is."""
    if source not in ("auto", "published", "generated"):
        raise InputError(f"source must be auto, published or generated, got {source!r}")
    there = has_data(*parts)
    if source == "published" and not there:
        missing = [part for part in parts if not has_data(part)]
        raise InputError(
            f"the published meshes are not at {mesh_folder()} ({', '.join(missing)}); set "
            "TACCEL_LAB_DATA, or take source generated"
        )
    return "published" if there and source != "generated" else "generated"


def read_stl(path: Path) -> TriangleMesh:
    """A binary STL file in metres, vertices of the same coordinates merged."""
    data = path.read_bytes()
    count = int(np.frombuffer(data, "<u4", 1, 80)[0]) if len(data) >= 84 else -1
    if len(data) != 84 + 50 * count:
        raise InputError(f"{path} is no binary STL file: {len(data)} bytes, {count} triangles")
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.frombuffer(data, record, count, 84)["corners"].reshape(-1, 3)
    vertices, index = np.unique(corners.astype(np.float64), axis=0, return_inverse=True)
    return TriangleMesh(vertices, index.reshape(-1, 3))


def read_vtk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [m], float64, [n, 3], and tets of positive volume, int32, [t, 4], of a legacy file.

    Unstructured grids in binary (big-endian, as the format says) of tets and nothing else, with
    cells as version 5.1 writes them (OFFSETS and CONNECTIVITY) or as older ones do.
    """
    data = path.read_bytes()
    lines = data[:200].split(b"\n")
    if not data.startswith(b"# vtk DataFile") or lines[2].strip() != b"BINARY":
        raise InputError(f"{path} is no legacy VTK file in binary")
    words, start = _header(path, data, b"POINTS ", 0)
    nodes = _values(data, words[2], 3 * int(words[1]), start).reshape(-1, 3).astype(np.float64)
    words, start = _header(path, data, b"CELLS ", start + nodes.size * 4)
    if data[start : start + 7] == b"OFFSETS":
        offsets, length = int(words[1]), int(words[2])
        words, start = _header(path, data, b"OFFSETS ", start)
        offset = _values(data, words[1], offsets, start)
        words, start = _header(path, data, b"CONNECTIVITY ", start + offset.nbytes)
        cells = _values(data, words[1], length, start)
        sizes = np.diff(offset)
        tets = cells.reshape(-1, 4) if (sizes == 4).all() else None
    else:
        cells = _values(data, "int", int(words[2]), start)
        rows = cells.reshape(-1, 5) if len(cells) == 5 * int(words[1]) else None
        tets = rows[:, 1:] if rows is not None and (rows[:, 0] == 4).all() else None
    if tets is None:
        raise InputError(f"{path} holds other cells than tets")
    tets = tets.astype(np.int32)
    p = nodes[tets]
    inverted = np.linalg.det(p[:, 1:] - p[:, :1]) < 0
    tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
    return nodes, tets


def _header(path: Path, data: bytes, keyword: bytes, start: int) -> tuple[list[str], int]:
    """Words of the line that begins with a keyword, and where the next line begins."""
    at = data.find(b"\n" + keyword, max(start - 1, 0)) + 1
    if at == 0:
        raise InputError(f"{path} has no {keyword.decode().strip()}")
    end = data.index(b"\n", at)
    return data[at:end].decode("ascii").split(), end + 1


def _values(data: bytes, kind: str, count: int, start: int) -> np.ndarray:
    if kind not in _TYPES:
        raise InputError(f"a legacy VTK array is of type {kind!r}; known: {', '.join(_TYPES)}")
    return np.frombuffer(data, _TYPES[kind], count, start)
