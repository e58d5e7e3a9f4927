# SPDX-License-Identifier: Apache-2.0
"""Tet meshes in legacy VTK files, read with numpy alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import read_regular_file

MAX_BYTES = 500 << 20
"""Five million tets in 64-bit indices: more than a GPU steps."""
_LINE_BYTES = 200
"""Of a line of words, of which the format allows 256 in the title and needs 40 elsewhere."""
_TYPES = {
    "float": ">f4",
    "double": ">f8",
    "int": ">i4",
    "vtktypeint64": ">i8",
    "vtktypeint32": ">i4",
}


def read_legacy_vtk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in the unit of the file, float64, [n, 3], and tets of positive volume, int32, [t, 4].

    Unstructured grids in binary (big-endian, as the format says) of tets and nothing else, with
    cells as version 5.1 writes them (OFFSETS and CONNECTIVITY) or as older ones do. Raises
    InputError for another or a damaged file, nodes that are not finite and tets of other nodes.
    """
    data = read_regular_file(path, MAX_BYTES, "a legacy VTK file")
    try:
        nodes, tets = _content(data)
    except InputError as error:
        raise InputError(f"{path} {error}") from None
    p = nodes[tets]
    with np.errstate(all="ignore"):  # Coordinates of 1e200 are for others to judge.
        inverted = np.linalg.det(p[:, 1:] - p[:, :1]) < 0
    tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
    return nodes, tets


def _content(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    lines = data[:512].split(b"\n")
    if not data.startswith(b"# vtk DataFile") or len(lines) < 3 or lines[2].strip() != b"BINARY":
        raise InputError("is no legacy VTK file in binary")
    words, start = _header(data, b"POINTS", 2, 0)
    nodes, start = _values(data, words[1], 3 * _count(words[0]), start)
    nodes = nodes.reshape(-1, 3).astype(np.float64)
    if not len(nodes) or not np.isfinite(nodes).all():
        raise InputError("has no points, or some that are NaN or infinite")
    words, start = _header(data, b"CELLS", 2, start)
    count, length = _count(words[0]), _count(words[1])
    if data.startswith(b"OFFSETS", start):
        words, start = _header(data, b"OFFSETS", 1, start)
        offset, start = _values(data, words[0], count, start)
        words, start = _header(data, b"CONNECTIVITY", 1, start)
        cells, start = _values(data, words[0], length, start)
        only_tets = np.array_equal(offset, 4 * np.arange(count)) and len(cells) == 4 * (count - 1)
        tets = cells.reshape(-1, 4) if only_tets else None
    else:
        cells, start = _values(data, "int", length, start)
        rows = cells.reshape(-1, 5) if len(cells) == 5 * count else None
        tets = rows[:, 1:] if rows is not None and (rows[:, 0] == 4).all() else None
    if tets is None or not len(tets):
        raise InputError("holds other cells than tets, or none")
    if tets.min() < 0 or tets.max() >= len(nodes):
        raise InputError(
            f"has tets of the nodes {tets.min()} to {tets.max()}, but nodes 0 to {len(nodes) - 1}"
        )
    return nodes, tets.astype(np.int32)


def _header(data: bytes, keyword: bytes, count: int, start: int) -> tuple[list[str], int]:
    """Words after a keyword that begins a line, and where the next line begins."""
    at = data.find(b"\n" + keyword + b" ", max(start - 1, 0)) + 1
    line, end, _ = data[at : at + _LINE_BYTES].partition(b"\n")
    words = line.decode("ascii", "replace").split()[1:]
    if at == 0 or not end or len(words) < count:
        raise InputError(f"is damaged: it has no line {keyword.decode()} with {count} words")
    return words, at + len(line) + 1


def _count(word: str) -> int:
    # So many digits are no count that a file can hold.
    if not (word.isascii() and word.isdigit() and len(word) < 12):
        raise InputError(f"is damaged: {word[:20]!r} is not a number of points or cells")
    return int(word)


def _values(data: bytes, kind: str, count: int, start: int) -> tuple[np.ndarray, int]:
    """An array and where it ends."""
    if kind not in _TYPES:
        raise InputError(f"has an array of type {kind[:20]!r}; known: {', '.join(_TYPES)}")
    end = start + count * np.dtype(_TYPES[kind]).itemsize
    if end > len(data):
        raise InputError(f"is cut short: an array ends at byte {end:,} of {len(data):,}")
    return np.frombuffer(data, _TYPES[kind], count, start), end
