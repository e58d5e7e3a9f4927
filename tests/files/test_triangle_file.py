# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes and Collada files are read or refused in a sentence."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import pyvista

from taccel_lab.bodies.mesh_checks import check_surface
from taccel_lab.errors import InputError, InputWarning
from taccel_lab.files import triangle_file
from taccel_lab.files.collada_file import read_collada
from taccel_lab.files.triangle_file import MAX_TRIANGLES, read_triangle_file

GOOD = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0\n1 0 0\n0 1 0\n0 0 1
3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2
"""


def test_faces_become_triangles_and_equal_points_one(tmp_path: Path) -> None:
    path = tmp_path / "square.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 0\nf 1 2 3 4\nf 5 3 2\n")
    points, faces = read_triangle_file(path)
    assert points.shape == (4, 3) and faces.shape == (3, 3)
    assert points.dtype == np.float64


@pytest.mark.thorough(cases=("negative", "no list"))
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        # These two end VTK by a signal.
        pytest.param("uchar int", "int int", "crashed", id="negative"),
        pytest.param(
            "list uchar int vertex_indices", "int a", r"vtk 9\S* crashed on it", id="no list"
        ),
        ("3 1 2 3", "3 1 2 9", r"points 0 to 9, but it has points 0 to 3$"),
        ("0 0 1\n", "nan 0 1\n", r"1 of 4 points have NaN .* point 3\)"),
        ("face 4", "face 4000000000", "4000000000 items 'face', but it has"),
        ("face 4", "face " + "9" * 5000, "9{20} items 'face', but it has"),
        ("vertex 4", "vertex 99999", "99999 items 'vertex', but it has"),
        ("uchar int", "uchar word", "holds no faces"),
    ],
)
def test_damaged_ply_files(old: str, new: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "part.ply"
    path.write_text(GOOD)
    assert len(read_triangle_file(path)[1]) == 4
    text = GOOD.replace("3 1 2 3", "-3 1 2 3") if new == "int int" else GOOD
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=rf"part\.ply.*{words}"):
        read_triangle_file(path)


def test_large_files_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "part.ply"
    path.write_text(GOOD)
    for limit, value, words in (
        ("MAX_TRIANGLES", 3, "has 4 faces; up to 3 are allowed"),
        ("MAX_BYTES", 100, r"has \d+ bytes; a triangle mesh .* 100 bytes"),
    ):
        monkeypatch.setattr(triangle_file, limit, value)
        with pytest.raises(InputError, match=rf"part\.ply {words}"):
            read_triangle_file(path)


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


# A box of 2 x 3 x 4 units from the origin, its faces outwards.
CORNERS = "0 0 0  2 0 0  2 3 0  0 3 0  0 0 4  2 0 4  2 3 4  0 3 4"
SQUARES = "0 3 2 1", "4 5 6 7", "0 1 5 4", "1 2 6 5", "2 3 7 6", "3 0 4 7"
INPUT = '<input semantic="VERTEX" source="#corners" offset="0"/>'
POLYLIST = (
    f'<polylist count="6" material="red">{INPUT}<vcount>4 4 4 4 4 4</vcount>'
    f"<p>{' '.join(SQUARES)}</p></polylist>"
)
POLYGONS = (
    f'<polygons count="6" material="red">{INPUT}'
    + "".join(f"<p>{square}</p>" for square in SQUARES)
    + "</polygons>"
)
TRIANGLES = (
    f'<triangles count="12" material="red">{INPUT}<p>'
    + " ".join(f"{a} {b} {c}  {a} {c} {d}" for a, b, c, d in map(str.split, SQUARES))
    + "</p></triangles>"
)
UNIT = '<unit meter="0.001" name="millimeter"/>'
PLACE = "<matrix>1 0 0 10  0 1 0 20  0 0 1 30  0 0 0 1</matrix>"


def collada(faces: str = POLYLIST, unit: str = UNIT, up: str = "Z_UP", place: str = PLACE) -> str:
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><created>2020-01-01T00:00:00Z</created><modified>2020-01-01T00:00:00Z</modified>
    {unit}<up_axis>{up}</up_axis></asset>
  <library_images><image id="i"><init_from>../../secret.png</init_from></image></library_images>
  <library_geometries><geometry id="box"><mesh>
    <source id="places"><float_array id="numbers" count="24">{CORNERS}</float_array>
      <technique_common><accessor source="#numbers" count="8" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common></source>
    <vertices id="corners"><input semantic="POSITION" source="#places"/></vertices>
    {faces}
    <lines count="1">{INPUT}<p>0 1</p></lines>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="scene">
    <node id="outer">{place}<node id="inner">
      <instance_geometry url="#box"><bind_material><technique_common>
        <instance_material symbol="red" target="#nothing"/></technique_common></bind_material>
      </instance_geometry>
      <instance_camera url="#none"/></node></node>
  </visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>"""


def read(folder: Path, text: str, **options: bool) -> tuple[np.ndarray, np.ndarray]:
    path = folder / "part.dae"
    path.write_text(text)
    return read_collada(path, **options)


def require_box(
    mesh: tuple[np.ndarray, np.ndarray], box: object, volume: float, atol: float = 0.0
) -> None:
    """Points fill a box, and faces look outwards around a volume."""
    points, faces = mesh
    extent = [points.min(axis=0), points.max(axis=0)]
    np.testing.assert_allclose(extent, box, rtol=0 if atol else 1e-6, atol=atol)
    a, b, c = (points[faces[:, k]] for k in range(3))
    found = np.einsum("fi,fi->", a, np.cross(b, c)) / 6
    assert found == pytest.approx(volume, rel=atol or 1e-6)


@pytest.mark.parametrize("faces", [POLYLIST, POLYGONS, TRIANGLES])
@pytest.mark.parametrize("up", ["X_UP", "Y_UP", "Z_UP"])
def test_a_box_in_millimetres_is_where_its_nodes_put_it(
    faces: str, up: str, tmp_path: Path
) -> None:
    points, triangles = read(tmp_path, collada(faces, up=up), as_drawn=True)
    assert points.shape == (8, 3) and triangles.shape == (12, 3)
    assert points.dtype == np.float64 and triangles.dtype == np.int64
    require_box((points, triangles), [[0.01, 0.02, 0.03], [0.012, 0.023, 0.034]], 24e-9)


@pytest.mark.parametrize(
    ("up", "box"),
    [
        ("X_UP", [[-0.023, -0.034, 0.01], [-0.02, -0.03, 0.012]]),
        ("Y_UP", [[0.01, -0.034, 0.02], [0.012, -0.03, 0.023]]),
    ],
)
def test_what_is_up_becomes_z(up: str, box: list[list[float]], tmp_path: Path) -> None:
    with pytest.warns(InputWarning, match=f"says {up}, so it is turned to z up"):
        require_box(read(tmp_path, collada(up=up)), box, 24e-9)


@pytest.mark.parametrize(
    ("unit", "meter"),
    [("", 1.0), ('<unit meter="1" name="meter"/>', 1.0), ('<unit meter="0.0254"/>', 0.0254)],
)
def test_units(unit: str, meter: float, tmp_path: Path) -> None:
    sides = [2 * meter, 3 * meter, 4 * meter]
    require_box(read(tmp_path, collada(unit=unit, place="")), [[0, 0, 0], sides], np.prod(sides))


def test_nodes_turn_scale_and_mirror(tmp_path: Path) -> None:
    """A quarter of a turn about z brings x to y; a mirrored surface still looks outwards."""
    place = "<translate>0 0 1</translate><rotate>0 0 1 90</rotate><scale>1 1 -2</scale>"
    mesh = read(tmp_path, collada(unit="", place=place))
    require_box(mesh, [[-3, 0, -7], [0, 2, 1]], 48, atol=1e-5)


def test_what_the_scene_shows_twice_is_there_twice(tmp_path: Path) -> None:
    more = '<node id="again"><instance_geometry url="#box"/></node></visual_scene>'
    text = collada(unit="").replace("</visual_scene>", more)
    points, faces = read(tmp_path, text)
    assert len(points) == 16 and len(faces) == 24


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("COLLADA", "SCENE", "root element is <SCENE>"),
        ('url="#box"', 'url="#ball"', "no readable Collada file: .*ball"),
        ("0 3 2 1", "0 3 2 99", "no readable Collada file"),
        ("0 3 2 1", "0 3 two 1", "no readable Collada file"),
        ("2 3 4", "2 3 nan", "'numbers' has entries that are no finite"),
        ("2 3 4", "2 3 x", "'numbers' has entries that are no finite"),
        ("2 3 4", "2 3", "no readable Collada file"),
        ('url="#scene"', 'url="#none"', "no readable Collada file"),
        ('<scene><instance_visual_scene url="#scene"/></scene>', "", "shows no faces"),
        ("</COLLADA>", "", "is not valid XML"),
        ("<COLLADA", "<!DOCTYPE a><COLLADA", "has a document type"),
    ],
)
def test_damaged_collada_files(old: str, new: str, words: str, tmp_path: Path) -> None:
    assert old in collada()
    with pytest.raises(InputError, match=rf"part\.dae.*{words}") as error:
        read(tmp_path, collada().replace(old, new))
    assert "\n" not in str(error.value)


def test_what_is_absent_or_not_installed_or_too_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    head, rest = TRIANGLES.split("<p>")
    many = head + "<p>" + "0 1 2 " * (MAX_TRIANGLES + 1) + rest
    with pytest.raises(InputError, match=r"has 500,0[01][0-9] faces; up to 500,000 are allowed"):
        read(tmp_path, collada(many))
    with pytest.raises(InputError, match="does not exist"):
        read_collada(tmp_path / "none.dae")
    monkeypatch.setitem(sys.modules, "collada", None)
    with pytest.raises(InputError, match=r"pycollada, which is not installed: pip install"):
        read(tmp_path, collada())
