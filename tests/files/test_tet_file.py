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

NODES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [5, 5, 5]])
TAGS = np.array([2, 4, 6, 8, 10])
"""Of the nodes in .msh files; the last one is of no tet."""
TET = TAGS[[0, 1, 2, 3]]


def text_2() -> bytes:
    nodes = "\n".join(f"{t} {x} {y} {z}" for t, (x, y, z) in zip(TAGS, NODES, strict=True))
    tet, triangle = " ".join(map(str, TET)), " ".join(map(str, TET[:3]))
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n5\n{nodes}\n$EndNodes\n"
        f"$Elements\n2\n1 2 2 0 1 {triangle}\n2 4 2 0 1 {tet}\n$EndElements\n"
    ).encode()


def bytes_2() -> bytes:
    nodes = b"".join(struct.pack("<i3d", t, *p) for t, p in zip(TAGS, NODES, strict=True))
    elements = struct.pack("<3i", 2, 1, 2) + struct.pack("<6i", 1, 0, 1, *TET[:3])
    elements += struct.pack("<3i", 4, 1, 2) + struct.pack("<7i", 2, 0, 1, *TET)
    head = b"$MeshFormat\n2.2 1 8\n" + struct.pack("<i", 1) + b"\n$EndMeshFormat\n"
    head += b"$Nodes\n5\n" + nodes + b"\n$EndNodes\n"
    return head + b"$Elements\n2\n" + elements + b"\n$EndElements\n"


def text_4() -> bytes:
    tags = "\n".join(map(str, TAGS))
    nodes = "\n".join(f"{x} {y} {z}" for x, y, z in NODES)
    tet, triangle = " ".join(map(str, TET)), " ".join(map(str, TET[:3]))
    return (
        f"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 5 2 10\n3 0 0 5\n{tags}\n{nodes}\n"
        f"$EndNodes\n$Elements\n2 2 1 2\n2 0 2 1\n1 {triangle}\n3 0 4 1\n2 {tet}\n$EndElements\n"
    ).encode()


def bytes_4() -> bytes:
    nodes = struct.pack("<4Q", 1, 5, 2, 10) + struct.pack("<3i", 3, 0, 0)
    nodes += struct.pack("<Q", 5) + TAGS.astype("<u8").tobytes() + NODES.astype("<f8").tobytes()
    elements = struct.pack("<4Q", 1, 1, 1, 1) + struct.pack("<3i", 3, 0, 4)
    elements += struct.pack("<Q", 1) + struct.pack("<5Q", 1, *TET)
    head = b"$MeshFormat\n4.1 1 8\n" + struct.pack("<i", 1) + b"\n$EndMeshFormat\n"
    head += b"$Nodes\n" + nodes + b"\n$EndNodes\n"
    return head + b"$Elements\n" + elements + b"\n$EndElements\n"


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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.replace(b"4.1 0", b"4.0 0"), r"version 4\.0 of Gmsh's format; 2\.2 and 4\.1"),
        (lambda d: d.replace(b"$EndElements", b"$End"), r"\$Elements is missing"),
        (lambda d: d.replace(b"2 4 6 8", b"2 4 6 7"), "tets of nodes that it does not have"),
        (lambda d: d.replace(b"3 0 4 1", b"3 0 4 9"), "numbers do not fit its counts"),
        (lambda d: d.replace(b"1 5 2 10", b"9999999999999 5 2 10"), "do not fit its counts"),
        (lambda d: d.replace(b"3 0 4 1", b"3 0 99 1"), "elements of Gmsh's type 99"),
        (lambda d: d.replace(b"3 0 4 1", b"3 0 3 1"), "has no tets: mesh its volume"),
        (lambda d: d.replace(b"0.0 0.0 1.0", b"0.0 nan 1.0"), "1 of 5 nodes have NaN"),
        (lambda d: d.replace(b"0.0 0.0 1.0", b"0.0 x 1.0"), "do not fit its counts"),
    ],
)
def test_damaged_gmsh_files(change: Callable[[bytes], bytes], words: str, tmp_path: Path) -> None:
    path = tmp_path / "gel.msh"
    path.write_bytes(change(text_4()))
    with pytest.raises(InputError, match=rf"gel\.msh.*{words}"):
        read_tet_file(path)


def test_what_holds_no_tets_is_refused(tmp_path: Path) -> None:
    (tmp_path / "gel.vtu").write_text("<VTKFile>")
    with pytest.raises(InputError, match="holds no tets"):
        read_tet_file(tmp_path / "gel.vtu")
    (tmp_path / "gel.txt").write_text("")
    with pytest.raises(InputError, match=r"only \.msh, \.vtu, \.vtk files"):
        read_tet_file(tmp_path / "gel.txt")


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
    ("data", "words"),
    [
        (b"# vtk DataFile Version 5.1", "not a readable mesh file"),
        (VTK_HEAD, "holds no tets"),
        (VTK_GOOD.replace(b"POINTS 4 double", b"POINTS 4"), "holds no tets"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS x"), "holds no tets"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS -4"), "vtk .* crashed on it"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS " + b"9" * 30), "holds no tets"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS 99999999"), "holds no tets"),
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
def test_damaged_legacy_files_are_refused(data: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "mesh.vtk"
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"mesh\.vtk.*{words}"):
        read_tet_file(path)
