# SPDX-License-Identifier: Apache-2.0
"""Tets of Gmsh's and VTK's files, and damaged ones, which end in a sentence with their name."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import pyvista

from taccel_lab.errors import InputError
from taccel_lab.files.tet_file import read_tet_file
from taccel_lab.files.vtk_tets import plain_tets

NODES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [5, 5, 5]])
TAGS = np.array([2, 4, 6, 8, 10])
"""Of the nodes in .msh files; the last one is of no tet."""
TET = TAGS[[0, 1, 2, 3]]


TRIANGLE = TET[:3]


def gmsh(version: str, nodes: bytes, elements: bytes) -> bytes:
    """A file of Gmsh's; ``version`` says whether numbers stand in words or in bytes."""
    mark = struct.pack("<i", 1) + b"\n" if " 1 " in version else b""
    return b"$MeshFormat\n%s\n%s$EndMeshFormat\n$Nodes\n%s\n$EndNodes\n$Elements\n%s\n%s" % (
        version.encode(), mark, nodes, elements, b"$EndElements\n"
    )  # fmt: skip


def words(numbers: np.ndarray) -> str:
    return "\n".join(" ".join(map(str, row)) for row in numbers)


def text_2() -> bytes:
    nodes = "\n".join(f"{t} {words([p])}" for t, p in zip(TAGS, NODES, strict=True))
    elements = f"2\n1 2 2 0 1 {words([TRIANGLE])}\n2 4 2 0 1 {words([TET])}"
    return gmsh("2.2 0 8", f"5\n{nodes}".encode(), elements.encode())


def bytes_2() -> bytes:
    nodes = b"".join(struct.pack("<i3d", t, *p) for t, p in zip(TAGS, NODES, strict=True))
    numbers = 2, 1, 2, 1, 0, 1, *TRIANGLE, 4, 1, 2, 2, 0, 1, *TET
    return gmsh("2.2 1 8", b"5\n" + nodes, b"2\n" + struct.pack("<19i", *numbers))


def text_4() -> bytes:
    nodes = f"1 5 2 10\n3 0 0 5\n{words(TAGS[:, None])}\n{words(NODES)}"
    elements = f"2 2 1 2\n2 0 2 1\n1 {words([TRIANGLE])}\n3 0 4 1\n2 {words([TET])}"
    return gmsh("4.1 0 8", nodes.encode(), elements.encode())


def bytes_4() -> bytes:
    nodes = struct.pack("<4Q3iQ", 1, 5, 2, 10, 3, 0, 0, 5) + TAGS.astype("<u8").tobytes()
    elements = struct.pack("<4Q3iQ5Q", 1, 1, 1, 1, 3, 0, 4, 1, 1, *TET)
    return gmsh("4.1 1 8", nodes + NODES.astype("<f8").tobytes(), elements)


@pytest.mark.parametrize("content", [text_2, bytes_2, text_4, bytes_4])
def test_tets_of_every_gmsh_format(content: Callable[[], bytes], tmp_path: Path) -> None:
    path = tmp_path / "gel.msh"
    path.write_bytes(content())
    nodes, tets = read_tet_file(path)
    assert nodes.tolist() == NODES[:4].tolist() and tets.tolist() == [[0, 1, 2, 3]]


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
def test_tets_of_vtk_are_turned_right_and_others_left_out(suffix: str, tmp_path: Path) -> None:
    cells = np.array([4, 0, 2, 1, 3, 3, 0, 1, 2])
    grid = pyvista.UnstructuredGrid(cells, np.array([10, 5]), NODES)
    grid.save(tmp_path / f"gel{suffix}")
    nodes, tets = read_tet_file(tmp_path / f"gel{suffix}")
    corners = nodes[tets[0]]
    assert len(tets) == 1 and np.linalg.det(corners[1:] - corners[0]) == pytest.approx(1)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_files_as_vtk_writes_them_are_read_without_it(kind: type, tmp_path: Path) -> None:
    rng, path = np.random.default_rng(1), tmp_path / "gel.vtk"
    kinds = rng.choice([5, 10, 24], 20)
    cells = [[size, *rng.integers(0, 30, size)] for size in map({5: 3, 10: 4, 24: 10}.get, kinds)]
    grid = pyvista.UnstructuredGrid(np.concatenate(cells), kinds, rng.random((30, 3)).astype(kind))
    grid.save(path)
    found = plain_tets(path.read_bytes())
    assert found is not None
    np.testing.assert_array_equal(found[0], grid.points)
    corners = [grid.cells_dict[k][:, :4] for k in (10, 24)]
    np.testing.assert_array_equal(found[1], np.concatenate(corners))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"4.1 0", b"4.0 0", r"version 4\.0 of Gmsh's format; 2\.2 and 4\.1"),
        (b"$EndElements", b"$End", r"\$Elements is missing"),
        (b"2 4 6 8", b"2 4 6 7", "tets of nodes that it does not have"),
        (b"3 0 4 1", b"3 0 4 9", "numbers do not fit its counts"),
        (b"1 5 2 10", b"9999999999999 5 2 10", "do not fit its counts"),
        (b"3 0 4 1", b"3 0 99 1", "elements of Gmsh's type 99"),
        (b"3 0 4 1", b"3 0 3 1", "has no tets: mesh its volume"),
        (b"0.0 0.0 1.0", b"0.0 nan 1.0", "1 of 5 nodes have NaN"),
        (b"0.0 0.0 1.0", b"0.0 x 1.0", "do not fit its counts"),
    ],
)
def test_damaged_gmsh_files(old: bytes, new: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / "gel.msh"
    path.write_bytes(text_4().replace(old, new))
    with pytest.raises(InputError, match=rf"gel\.msh.*{says}"):
        read_tet_file(path)


def test_what_holds_no_tets_is_refused(tmp_path: Path) -> None:
    for name, says in (
        ("gel.vtu", "holds no tets"),
        ("gel.txt", r"only \.msh, \.vtu, \.vtk files"),
    ):
        (tmp_path / name).write_text("<VTKFile>")
        with pytest.raises(InputError, match=says):
            read_tet_file(tmp_path / name)


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.5]])
VTK_HEAD = b"# vtk DataFile Version 5.1\nvtk output\nBINARY\nDATASET UNSTRUCTURED_GRID\n"


def vtk(version: str, tet: list[int], nodes: np.ndarray = CORNERS) -> bytes:
    data = VTK_HEAD.replace(b"5.1", version.encode())
    data += b"POINTS 4 double\n" + nodes.astype(">f8").tobytes() + b"\n"
    if version == "5.1":
        data += b"CELLS 2 4\nOFFSETS vtktypeint64\n" + np.array([0, 4], ">i8").tobytes()
        data += b"\nCONNECTIVITY vtktypeint64\n" + np.array(tet, ">i8").tobytes()
    else:
        data += b"CELLS 1 5\n" + np.array([4, *tet], ">i4").tobytes()
    return data + b"\nCELL_TYPES 1\n" + np.array([10], ">i4").tobytes()


@pytest.mark.parametrize(("version", "tet"), [("5.1", [0, 1, 2, 3]), ("4.2", [0, 2, 1, 3])])
def test_both_layouts_are_read(version: str, tet: list[int], tmp_path: Path) -> None:
    path = tmp_path / "mesh.vtk"
    path.write_bytes(vtk(version, tet))
    found, tets = read_tet_file(path)
    np.testing.assert_array_equal(found, CORNERS)
    p = found[tets[0]]
    assert np.linalg.det(p[1:] - p[0]) > 0


VTK_GOOD = vtk("5.1", [0, 1, 2, 3])


@pytest.mark.thorough(cases=("data4-vtk .* crashed on it",))
@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"# vtk DataFile Version 5.1", "not a readable mesh file"),
        (VTK_HEAD, "holds no tets"),
        (VTK_GOOD.replace(b"POINTS 4 double", b"POINTS 4"), "holds no tets"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS x"), "holds no tets"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS -4"), "vtk .* crashed on it"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS " + b"9" * 30), "holds no tets"),
        (VTK_GOOD.replace(b"double", b"half\xff"), "holds no tets"),
        (VTK_GOOD.replace(b"CELLS 2 4", b"CELLS 2 3"), "holds no tets"),
        (VTK_GOOD.replace(b"CELLS 2 4", b"CELLS 1 0"), "holds no tets"),
        (VTK_GOOD[:230], "holds no tets"),
        (vtk("5.1", [0, 1, 2, 4]), "tets of nodes that it does not have"),
        (vtk("4.2", [0, 1, 2, -1]), "tets of nodes that it does not have"),
        (vtk("5.1", [0, 1, 2, 2**32 + 3]), "tets of nodes that it does not have"),
        (vtk("4.2", [0, 1, 2, 3], np.full((4, 3), np.inf)), "NaN or infinite"),
    ],
)
def test_damaged_legacy_files_are_refused(data: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / "mesh.vtk"
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"mesh\.vtk.*{says}"):
        read_tet_file(path)
