# SPDX-License-Identifier: Apache-2.0
"""Tets of VTK's legacy files as VTK 9 itself writes them, read with numpy alone.

The format, version 5.1, big-endian:
https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html
"""

from __future__ import annotations

import re

import numpy as np

from taccel_lab.files.vtk_mesh import QUADRATIC_TETRA, TETRA

CORNERS_FIRST = {TETRA: 4, QUADRATIC_TETRA: 10}
"""Nodes of both kinds of tets, the corners first."""
_PARTS = (
    rb"# vtk DataFile Version 5\.1\n.*\nBINARY\nDATASET UNSTRUCTURED_GRID\n"
    rb"POINTS (\d{1,9}) (float|double)\n",
    rb"\n?CELLS (\d{1,9}) (\d{1,9})\nOFFSETS vtktypeint64\n",
    rb"\n?CONNECTIVITY vtktypeint64\n",
    rb"\n?CELL_TYPES (\d{1,9})\n",
)


def plain_tets(data: bytes) -> tuple[np.ndarray, np.ndarray] | None:
    """Nodes, float64, [n, 3], and corners of the tets of both orders, int64, [t, 4], as they stand
    in a file; None for any other layout, and where counts and lists do not fit one another."""
    at = 0

    def words(part: bytes) -> tuple[bytes, ...]:
        nonlocal at
        found = re.compile(part).match(data, at)
        if found is None:
            raise ValueError
        at = found.end()
        return found.groups()

    def numbers(count: int, kind: str) -> np.ndarray:
        nonlocal at
        found = np.frombuffer(data, kind, count, at)
        at += found.nbytes
        return found

    points, offsets, connectivity, types = _PARTS
    try:
        count, kind = words(points)
        nodes = numbers(3 * int(count), ">f8" if kind == b"double" else ">f4").reshape(-1, 3)
        ends, used = map(int, words(offsets))
        starts = numbers(ends, ">i8").astype(np.int64)
        words(connectivity)
        listed = numbers(used, ">i8").astype(np.int64)
        (cells,) = map(int, words(types))
        kinds = numbers(cells, ">i4")
    except ValueError:
        return None
    sizes = np.diff(starts)
    if len(sizes) != cells or not cells or starts[0] != 0 or starts[-1] != used or sizes.min() < 0:
        return None
    if any((sizes[kinds == kind] != size).any() for kind, size in CORNERS_FIRST.items()):
        return None
    first = np.concatenate([starts[:-1][kinds == kind] for kind in CORNERS_FIRST])
    return nodes.astype(np.float64), listed[first[:, None] + np.arange(4)]
