# SPDX-License-Identifier: Apache-2.0
"""Legacy VTK files of tets: both layouts are read, damaged ones end in a sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.reading.legacy_vtk import read_legacy_vtk

NODES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.5]])
HEAD = b"# vtk DataFile Version 5.1\nvtk output\nBINARY\nDATASET UNSTRUCTURED_GRID\n"


def content(version: str, tet: list[int], nodes: np.ndarray = NODES) -> bytes:
    data = HEAD + b"POINTS 4 double\n" + nodes.astype(">f8").tobytes() + b"\n"
    if version == "5.1":
        data += b"CELLS 2 4\nOFFSETS vtktypeint64\n" + np.array([0, 4], ">i8").tobytes()
        data += b"\nCONNECTIVITY vtktypeint64\n" + np.array(tet, ">i8").tobytes()
    else:
        data += b"CELLS 1 5\n" + np.array([4, *tet], ">i4").tobytes()
    return data + b"\nCELL_TYPES 1\n" + np.array([10], ">i4").tobytes()


@pytest.mark.parametrize(("version", "tet"), [("5.1", [0, 1, 2, 3]), ("4.2", [0, 2, 1, 3])])
def test_both_layouts_are_read(version: str, tet: list[int], tmp_path: Path) -> None:
    path = tmp_path / "mesh.vtk"
    path.write_bytes(content(version, tet))
    found, tets = read_legacy_vtk(path)
    np.testing.assert_array_equal(found, NODES)
    p = found[tets[0]]
    assert np.linalg.det(p[1:] - p[0]) > 0


GOOD = content("5.1", [0, 1, 2, 3])


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"# vtk DataFile Version 5.1", "no legacy VTK file in binary"),
        (b"# vtk DataFile Version 5.1\nx\nASCII\n", "no legacy VTK file in binary"),
        (HEAD, "no line POINTS with 2 words"),
        (GOOD.replace(b"POINTS 4 double", b"POINTS 4"), "no line POINTS with 2 words"),
        (GOOD.replace(b"POINTS 4", b"POINTS x"), "'x' is not a number of points or cells"),
        (GOOD.replace(b"POINTS 4", b"POINTS -4"), "'-4' is not a number"),
        (GOOD.replace(b"POINTS 4", b"POINTS " + b"9" * 30), "'9{20}' is not a number"),
        (
            GOOD.replace(b"POINTS 4", b"POINTS 99999999"),
            r"array ends at byte 2,4\d\d,",
        ),
        (GOOD.replace(b"double", b"half\xff"), "an array of type 'half\ufffd'; known: float"),
        (GOOD.replace(b"CELLS 2 4", b"CELLS 2 3"), "holds other cells than tets"),
        (GOOD.replace(b"CELLS 2 4", b"CELLS 1 0"), "holds other cells than tets, or none"),
        (GOOD[:230], "cut short|no line"),
        (content("5.1", [0, 1, 2, 4]), "tets of the nodes 0 to 4, but nodes 0 to 3"),
        (content("4.2", [0, 1, 2, -1]), "tets of the nodes -1 to 2"),
        (content("5.1", [0, 1, 2, 2**32 + 3]), "tets of the nodes 0 to 4294967299"),
        (content("4.2", [0, 1, 2, 3], np.full((4, 3), np.inf)), "NaN or infinite"),
    ],
)
def test_damaged_files_are_named(data: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "mesh.vtk"
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"mesh\.vtk .*({words})"):
        read_legacy_vtk(path)
