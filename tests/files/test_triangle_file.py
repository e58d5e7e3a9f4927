# SPDX-License-Identifier: Apache-2.0
"""Damaged STL, PLY, OBJ and legacy VTK files end in a sentence with their name."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import pyvista

from taccel_lab.bodies.mesh_checks import check_surface
from taccel_lab.errors import InputError, InputWarning
from taccel_lab.files import triangle_file
from taccel_lab.files.legacy_vtk import read_legacy_vtk
from taccel_lab.files.triangle_file import read_triangle_file

POINTS = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
FACES = "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
HEAD = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
"""
GOOD = HEAD + POINTS + FACES


def test_faces_become_triangles_and_equal_points_one(tmp_path: Path) -> None:
    path = tmp_path / "square.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 0\nf 1 2 3 4\nf 5 3 2\n")
    points, faces = read_triangle_file(path)
    assert points.shape == (4, 3) and faces.shape == (3, 3)
    assert points.dtype == np.float64


@pytest.mark.parametrize(
    ("change", "words"),
    [
        # These two end VTK by a signal.
        (lambda t: t.replace("uchar int", "int int").replace("3 1 2 3", "-3 1 2 3"), "crashed"),
        (lambda t: t.replace("list uchar int vertex_indices", "int a"), r"vtk 9\S* crashed on it"),
        (lambda t: t.replace("3 1 2 3", "3 1 2 9"), r"points 0 to 9, but it has points 0 to 3$"),
        (lambda t: t.replace("0 0 1\n", "nan 0 1\n"), r"1 of 4 points have NaN .* point 3\)"),
        (lambda t: t.replace("face 4", "face 4000000000"), "4000000000 items 'face', but it has"),
        (lambda t: t.replace("face 4", "face " + "9" * 5000), "9{20} items 'face', but it has"),
        (lambda t: t.replace("vertex 4", "vertex 99999"), "99999 items 'vertex', but it has"),
        (lambda t: t.replace("uchar int", "uchar word"), "holds no faces"),
    ],
)
def test_damaged_ply_files(change: Callable[[str], str], words: str, tmp_path: Path) -> None:
    path = tmp_path / "part.ply"
    path.write_text(GOOD)
    assert len(read_triangle_file(path)[1]) == 4
    path.write_text(change(GOOD))
    with pytest.raises(InputError, match=rf"part\.ply.*{words}"):
        read_triangle_file(path)


def test_large_files_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(triangle_file, "MAX_TRIANGLES", 3)
    path = tmp_path / "part.ply"
    path.write_text(GOOD)
    with pytest.raises(InputError, match=r"part\.ply has 4 faces; up to 3 are allowed"):
        read_triangle_file(path)
    monkeypatch.setattr(triangle_file, "MAX_BYTES", 100)
    with pytest.raises(InputError, match=r"part\.ply has \d+ bytes; a triangle mesh .* 100 bytes"):
        read_triangle_file(path)


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_files_cut_short_or_overwritten_never_end_the_process(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"ball.{suffix}"
    pyvista.Sphere(radius=2, theta_resolution=6, phi_resolution=6).save(path)
    data = path.read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(6):
        start, length = int(rng.integers(len(data))), int(rng.integers(1, 60))
        noise = bytes(rng.integers(0, 256, length, dtype=np.uint8))
        for broken in (data[:start], data[:start] + noise + data[start + length :]):
            path.write_bytes(broken)
            try:
                points, faces = read_triangle_file(path)
            except InputError as error:
                assert str(path) in str(error)
            else:
                assert np.isfinite(points).all() and faces.max() < len(points)


CUBE = """v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\nv 0.5 0 0
f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7\nf 4 1 5\nf 4 5 8
"""
FRONT = "f 1 2 6\nf 1 6 5\n"
SPLIT_FRONT = "f 1 9 6\nf 9 2 6\nf 1 6 5\n"
"""A corner in the middle of an edge that the face below does not have."""


@pytest.mark.parametrize(
    ("more", "idle"),
    [
        (FRONT, 0),
        (FRONT + "f 1 2 9\n", 1),
        (FRONT + "f 2 6 1\n", 1),
        (FRONT + "f 1 2 9\nf 6 1 2\nf 1 4 3\n", 3),
        # Without it the surface would be open.
        (SPLIT_FRONT + "f 1 2 9\n", 0),
        # Turned around it is a fault of the surface, which others name.
        (FRONT + "f 1 6 2\n", 0),
    ],
)
def test_idle_triangles_go_from_a_closed_surface(more: str, idle: int, tmp_path: Path) -> None:
    path = tmp_path / "cube.obj"
    path.write_text(CUBE + more)
    words = rf"{idle} of \d+ triangles have no area or stand there twice; they are left out"
    with pytest.warns(InputWarning, match=words) if idle else nullcontext():
        points, faces = read_triangle_file(path)
    if idle:
        assert len(points) == 8 and len(faces) == 12
        check_surface(points, faces, "cube", closed=True)
    else:
        assert len(faces) == 10 + more.count("f")


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
@pytest.mark.parametrize(
    ("kept", "given"),
    [("MD5-d41d8cd9", "ball.{}"), ("ball.{}", "newest"), ("ball.v2", "ball.{}"), ("b.stl", "b.{}")],
)
def test_links_are_read_by_their_own_name_first(
    suffix: str, kept: str, given: str, tmp_path: Path
) -> None:
    """git-annex and DVC keep the content under a digest; others link to the newest file."""
    path = tmp_path / f"ball.{suffix}"
    pyvista.Sphere(radius=2, theta_resolution=6, phi_resolution=6).save(path)
    (tmp_path / "store").mkdir()
    path = path.rename(tmp_path / "store" / kept.format(suffix))
    link = tmp_path / given.format(suffix)
    link.symlink_to(path)
    points, faces = read_triangle_file(link)
    assert len(points) == 26 and len(faces) == 48


NODES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.5]])
VTK_HEAD = b"# vtk DataFile Version 5.1\nvtk output\nBINARY\nDATASET UNSTRUCTURED_GRID\n"


def vtk(version: str, tet: list[int], nodes: np.ndarray = NODES) -> bytes:
    data = VTK_HEAD + b"POINTS 4 double\n" + nodes.astype(">f8").tobytes() + b"\n"
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
    found, tets = read_legacy_vtk(path)
    np.testing.assert_array_equal(found, NODES)
    p = found[tets[0]]
    assert np.linalg.det(p[1:] - p[0]) > 0


VTK_GOOD = vtk("5.1", [0, 1, 2, 3])


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"# vtk DataFile Version 5.1", "no legacy VTK file in binary"),
        (b"# vtk DataFile Version 5.1\nx\nASCII\n", "no legacy VTK file in binary"),
        (VTK_HEAD, "no line POINTS with 2 words"),
        (VTK_GOOD.replace(b"POINTS 4 double", b"POINTS 4"), "no line POINTS with 2 words"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS x"), "'x' is not a number of points or cells"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS -4"), "'-4' is not a number"),
        (VTK_GOOD.replace(b"POINTS 4", b"POINTS " + b"9" * 30), "'9{20}' is not a number"),
        (
            VTK_GOOD.replace(b"POINTS 4", b"POINTS 99999999"),
            r"array ends at byte 2,4\d\d,",
        ),
        (VTK_GOOD.replace(b"double", b"half\xff"), "an array of type 'half\ufffd'; known: float"),
        (VTK_GOOD.replace(b"CELLS 2 4", b"CELLS 2 3"), "holds other cells than tets"),
        (VTK_GOOD.replace(b"CELLS 2 4", b"CELLS 1 0"), "holds other cells than tets, or none"),
        (VTK_GOOD[:230], "cut short|no line"),
        (vtk("5.1", [0, 1, 2, 4]), "tets of the nodes 0 to 4, but nodes 0 to 3"),
        (vtk("4.2", [0, 1, 2, -1]), "tets of the nodes -1 to 2"),
        (vtk("5.1", [0, 1, 2, 2**32 + 3]), "tets of the nodes 0 to 4294967299"),
        (vtk("4.2", [0, 1, 2, 3], np.full((4, 3), np.inf)), "NaN or infinite"),
    ],
)
def test_damaged_files_are_named(data: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "mesh.vtk"
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"mesh\.vtk .*({words})"):
        read_legacy_vtk(path)
