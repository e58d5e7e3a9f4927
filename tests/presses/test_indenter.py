# SPDX-License-Identifier: Apache-2.0
"""Indenters from text and mesh files: size, closed, right way round, what they touch, refusals."""

from __future__ import annotations

import math
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import pyvista
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.presses import Indenter, PressEnv, PressSetup, parse_indenter
from taccel_lab.presses.indenter import edge_mesh
from taccel_lab.scene import Material, TriangleMesh, box_mesh
from taccel_lab.studies.presses.standard import StandardPress


def volume_mm3(mesh: TriangleMesh) -> float:
    """Signed: below 0 of faces that look inwards."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    return 1e9 * float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize(
    ("text", "extent_mm", "volume"),
    [("cylinder:1.5", [3, 3, 4], math.pi * 1.5**2 * 4), ("box:4x2", [4, 2, 4], 32)],
)
def test_sizes_are_read_in_mm(text, extent_mm, volume):
    mesh = parse_indenter(text).shape
    assert 1e3 * np.ptp(mesh.vertices_m, axis=0) == pytest.approx(extent_mm, rel=2e-3)
    assert volume_mm3(mesh) == pytest.approx(volume, rel=2e-3)
    for size in (0.05, 1 / 3, 100.0):
        assert parse_indenter(f"sphere:{size!r}").shape.radius_m == pytest.approx(size * 1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not understood"),
        ("sphere:", "'' is not a number"),
        ("ball:2", "not understood; allowed: sphere:RADIUS"),
        ("sphere:2mm", "'2mm' is not a number"),
        ("sphere:0", r"must lie in \[0.05, 100\] mm, got 0 mm"),
        ("sphere:nan", r"must lie in \[0.05, 100\] mm, got nan mm"),
        ("cylinder:inf", r"must lie in \[0.05, 100\] mm, got inf mm"),
        ("box:4x", "'' is not a number"),
        ("roller:-2x3", "must lie in"),
        ("edge:5x6", r"opening angle must lie in \[10, 170\] deg, got 5 deg"),
        ("edge:90x6x0.01", r"must lie in \[0.05, 100\] mm, got 0.01 mm"),
        ("edge:90x6x50", r"rounded by 50 mm leaves no flanks"),
        ("grating:1x2.5x4", r"ridges must be a whole number in \[2, 100\], got 2.5"),
        ("grating:5x30x4", "is 150 mm wide; at most 100 mm"),
        ("pair:1x0", r"must lie in \[0.05, 100\] mm, got 0 mm"),
        ("mesh:", "is a folder"),
        ("mesh:absent.stl", "absent.stl does not exist"),
    ],
)
def test_bad_text(text, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_indenter(text)
    assert repr(text) in str(caught.value) or text.startswith("mesh")


def save(surface: pyvista.PolyData, path: Path) -> str:
    surface.save(path)
    return f"mesh:{path}"


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_a_mesh_file_keeps_its_origin_and_axes(suffix, tmp_path):
    cone = pyvista.Cone(center=(7, -3, 20), direction=(0, 0, -1), height=4, radius=1.5)
    mesh = parse_indenter(save(cone.triangulate(), tmp_path / f"cone.{suffix}")).shape
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    assert 0.5e3 * (low + high) == pytest.approx([7, -3, 20], abs=0.1)
    tip = mesh.vertices_m[mesh.vertices_m[:, 2].argmin()]
    assert 1e3 * tip == pytest.approx([7, -3, 18], abs=1e-4)
    assert volume_mm3(mesh) > 0


@pytest.mark.parametrize(
    ("axis", "right", "down"),
    [
        ("-z", (1, 0, 0), (0, 1, 0)),
        ("+z", (1, 0, 0), (0, -1, 0)),
        ("+x", (0, 0, 1), (0, 1, 0)),
        ("-x", (0, 0, -1), (0, 1, 0)),
        ("+y", (1, 0, 0), (0, 0, 1)),
        ("-y", (1, 0, 0), (0, 0, -1)),
    ],
)
def test_an_axis_of_the_file_points_into_the_gel(axis, right, down, tmp_path):
    """And the others turn with it, without a mirror."""
    into = np.eye(3)["xyz".index(axis[1])] * (1 if axis[0] == "+" else -1)
    center = 2 * into + 3.0 * np.array(right) + 1.0 * np.array(down)
    cone = pyvista.Cone(center=center, direction=into, height=4, radius=1.0).triangulate()
    mesh = parse_indenter(save(cone, tmp_path / "cone.ply") + f"@{axis}").shape
    tip = mesh.vertices_m[mesh.vertices_m[:, 2].argmin()]
    assert 1e3 * tip == pytest.approx([3.0, 1.0, -4.0], abs=1e-4)
    assert volume_mm3(mesh) > 0


def cuboid() -> tuple[np.ndarray, np.ndarray]:
    """Corners [mm] and rows (3, a, b, c) of the faces."""
    found = pyvista.Cube(x_length=3, y_length=2, z_length=1).triangulate().clean()
    return np.array(found.points), np.array(found.faces.reshape(-1, 4))


POINTS, FACES = cuboid()
INWARDS = FACES[:, [0, 1, 3, 2]]
BESIDE = POINTS + np.array([5.0, 0, 0])


@pytest.mark.parametrize(
    ("parts", "volume", "words"),
    [
        ([(POINTS, FACES), (BESIDE, FACES)], 12, None),
        ([(POINTS, INWARDS)], 6, "it was inside out, and turned round"),
        ([(POINTS, FACES), (BESIDE, INWARDS)], 12, "1 of its 2 parts were inside out"),
        ([(POINTS, FACES), (0.5 * POINTS, INWARDS)], 5.25, None),
        ([(POINTS, INWARDS), (0.5 * POINTS, FACES)], 5.25, "2 of its 2 parts"),
    ],
    ids=["good", "whole", "part", "hollow", "turned hollow"],
)
def test_a_file_that_was_inside_out_is_turned_and_said_to_be(parts, volume, words, tmp_path):
    """A part beside another as well; a cavity looks inwards, and a good file needs no word."""
    joined = pyvista.merge([pyvista.PolyData(at, rows) for at, rows in parts])
    surface = joined.extract_surface(algorithm="dataset_surface")
    found = parse_indenter(save(surface, tmp_path / "parts.stl"))
    assert volume_mm3(found.shape) == pytest.approx(volume, rel=1e-6)
    assert found.remarks == () if words is None else words in found.remarks[0]


def triangles(*rows: tuple[int, int, int]) -> pyvista.PolyData:
    corners = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0]])
    return pyvista.PolyData(corners, np.array([[3, *row] for row in rows]))


FIN = np.vstack([FACES, [3, FACES[0, 1], FACES[0, 2], len(POINTS)]])
BOTH_WAYS = np.where(np.arange(12)[:, None] == 4, INWARDS, FACES)


def crossing() -> pyvista.PolyData:
    one, two = (pyvista.Cube(center=(0.7 * k, 0.3 * k, 0.2 * k)).triangulate() for k in range(2))
    return one.append_polydata(two)


@pytest.mark.parametrize(
    ("surface", "words"),
    [
        (
            pyvista.PolyData(np.vstack([POINTS, [0.0, 0.0, 5.0]]), FIN),
            "is not manifold: 1 edges belong to more than two faces",
        ),
        (pyvista.PolyData(POINTS, BOTH_WAYS), "neighbouring faces are oriented differently"),
        (crossing(), r"intersects itself: \d+ times an edge passes"),
        (triangles((0, 1, 2)), r"is not closed: 3 edges belong to one face only"),
        (triangles(*[(0, 1, 2)] * 4), r"3 edges belong to more than two faces"),
        (
            triangles((0, 1, 2), (0, 2, 1)),
            r"encloses 0 mm\^3, 0 mm thick on average; a body of at least",
        ),
        (pyvista.Sphere(radius=2.0, center=(250, 0, 0)), r"reaches 25[12].* mm from its origin"),
    ],
)
def test_surfaces_of_no_body_are_refused(surface, words, tmp_path):
    with pytest.raises(InputError, match=rf"bad\.obj.*{words}"):
        parse_indenter(save(surface, tmp_path / "bad.obj"))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("scale", "unit"), [(1e-3, "metres"), (1 / 254, "inches"), (1e3, ""), (1e6, "")]
)
def test_a_mesh_in_another_unit_is_refused(scale, unit, tmp_path):
    ball = save(pyvista.Sphere(radius=0.4 * scale), tmp_path / "ball.stl")
    with pytest.raises(InputError, match=rf"mm across; a size in \[0.1, 100\] mm.*{unit}"):
        parse_indenter(ball)


def test_parts_smaller_than_the_depth_or_an_element_are_refused(tmp_path):
    """By whoever meshes a gel for it, with its size in other units."""
    puck = pyvista.Cylinder(direction=(0, 0, 1), radius=0.3, height=0.4)
    text = save(puck, tmp_path / "puck.stl")
    tool = parse_indenter(text)
    assert tool.contact(0.5) is not None
    words = r"0.6 mm across: less than the press is deep, 0.7 mm; .* 15.24 mm .*inches .* 600 mm"
    with pytest.raises(InputError, match=words):
        tool.contact(0.7)
    with pytest.raises(InputError, match=words):
        StandardPress("one", (text,), depth_mm=0.7)
    words = r"less than an element of the gel's mesh is long there, 2.12 mm"
    for cells, refused in ((4, True), (20, False)):
        mesh = block_mesh((cells, cells, 2), (6e-3, 6e-3, 3e-3))
        with pytest.raises(InputError, match=words) if refused else nullcontext():
            PressEnv(PressSetup(mesh, Material(1e5, 0.4), tool), np.zeros((1, 2)))


def test_a_part_of_python_in_millimetres_is_refused():
    box = box_mesh((0.06, 0.06, 0.004))
    tool = Indenter("puck", TriangleMesh(1e3 * box.vertices_m, box.faces))
    with pytest.raises(InputError, match=r"6e\+04 mm across: at most 1000 mm"):
        tool.contact(0.3)


sizes = st.floats(0.1, 10.0)


def sound_mesh(text: str) -> tuple[TriangleMesh, np.ndarray]:
    """The tool's mesh, which is closed, manifold and wound alike, and its vertices [mm]."""
    mesh = parse_indenter(text).shape
    edges = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges)
    assert all((b, a) in directed for a, b in directed)
    assert volume_mm3(mesh) > 0
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    assert (low + high)[:2] == pytest.approx(np.zeros(2), abs=1e-12)
    return mesh, mesh.vertices_m * 1e3


@settings(max_examples=20)
@given(radius=sizes, length=sizes)
def test_roller(radius, length):
    mesh, vertices = sound_mesh(f"roller:{radius!r}x{length!r}")
    assert volume_mm3(mesh) == pytest.approx(math.pi * radius**2 * length, rel=1e-3)
    extent = [2 * radius, length, 2 * radius]
    assert np.ptp(vertices, axis=0) == pytest.approx(extent, rel=1e-3)
    # A vertex lies at the very bottom, so that first touch is that of the true cylinder.
    assert vertices[:, 2].min() == pytest.approx(-radius, rel=1e-12)


@settings(max_examples=20)
@given(angle=st.floats(10, 170), length=sizes, radius=st.none() | st.floats(0.05, 0.2))
def test_edge(angle, length, radius):
    _, vertices = sound_mesh(f"edge:{angle!r}x{length!r}" + (f"x{radius!r}" if radius else ""))
    assert np.ptp(vertices[:, 1]) == pytest.approx(length)
    section = np.unique(vertices[:, [0, 2]].round(9), axis=0)
    assert (section[:, 1] > section[:, 1].max() - 1e-9).sum() == 2
    right = section[section[:, 0] >= 0]
    right = right[np.argsort(right[:, 1])]
    flank = right[-1] - right[-2]
    assert math.degrees(math.atan2(flank[0], flank[1])) == pytest.approx(angle / 2, abs=1e-4)
    # Convex, its lowest point on the axis.
    assert section[np.argmin(section[:, 1]), 0] == pytest.approx(0, abs=1e-9)


def test_a_rounded_edge_has_its_radius():
    mesh = edge_mesh(math.degrees(1.2), 5e-3, 0.1e-3)
    low = mesh.vertices_m[:, 2].min()
    tip = mesh.vertices_m[mesh.vertices_m[:, 2] < low + 0.03e-3]
    reach = np.hypot(tip[:, 0], tip[:, 2] - low - 0.1e-3)
    assert len(tip) > 6
    assert reach == pytest.approx(np.full(len(tip), 0.1e-3), rel=1e-6)


@settings(max_examples=20)
@given(pitch=st.floats(0.1, 3.0), ridges=st.integers(2, 12), length=sizes)
def test_grating(pitch, ridges, length):
    mesh, vertices = sound_mesh(f"grating:{pitch!r}x{ridges}x{length!r}")
    x = np.unique(vertices[vertices[:, 2] < vertices[:, 2].min() + 1e-9, 0].round(9))
    assert len(x) == 2 * ridges
    assert x[1::2] - x[::2] == pytest.approx(np.full(ridges, pitch / 2), abs=1e-8)
    assert np.diff(x[::2]) == pytest.approx(np.full(ridges - 1, pitch), abs=1e-8)
    plate = max(pitch, 1.0) * (ridges - 0.5) * pitch * length
    assert volume_mm3(mesh) == pytest.approx(plate + ridges * pitch**2 / 2 * length, rel=1e-9)


@settings(max_examples=20)
@given(radius=sizes, gap=sizes)
def test_pair(radius, gap):
    _, vertices = sound_mesh(f"pair:{radius!r}x{gap!r}")
    right = vertices[vertices[:, 0] > 0]
    assert right[:, 0].min() == pytest.approx(gap / 2, rel=1e-6)
    tip = right[np.argmin(right[:, 2])]
    assert tip[:2] == pytest.approx([radius + gap / 2, 0.0], abs=1e-9)
    # The lower part is half of a sphere.
    centre = tip + [0, 0, radius]
    below = np.linalg.norm(right[right[:, 2] < centre[2]] - centre, axis=1)
    assert below == pytest.approx(np.full(len(below), radius), rel=1e-9)


@pytest.mark.parametrize(("depth_mm", "radius_mm"), [(0.5, 0.968), (5.0, 2.0)])
def test_the_radius_of_a_ball_is_hertz(depth_mm, radius_mm):
    assert parse_indenter("sphere:2.0").contact(depth_mm) == pytest.approx(radius_mm, rel=1e-3)


PAIR = 2 * math.pi * 0.06 / (math.pi * 0.06 + 2 * math.sqrt(0.06))


@pytest.mark.parametrize(
    ("text", "depth_mm", "half_mm", "filled"),
    [
        ("cylinder:1.5", 0.4, (1.5, 1.5), 1.0),
        ("box:6x8", 0.5, (3.0, 4.0), 1.0),
        ("roller:2x6", 0.5, (0.968, 3.0), 1.0),
        ("edge:90x6", 0.4, (0.2, 3.0), 1.0),
        ("edge:60x5", 0.4, (0.2 * math.tan(math.radians(30)), 2.5), 1.0),
        ("grating:2x4x6", 0.4, (3.5, 3.0), 4 / 7),
        ("pair:0.25x0.5", 0.4, (0.25 + 0.25 + math.sqrt(0.25**2 - 0.05**2), 0.245), PAIR),
    ],
)
def test_the_outline_of_a_tool_and_how_much_of_it_is_filled(text, depth_mm, half_mm, filled):
    section = parse_indenter(text).contact(depth_mm)
    assert np.abs(section.outline_mm).max(axis=0) == pytest.approx(half_mm, rel=0.02)
    ahead = np.roll(section.outline_mm, -1, axis=0) - section.outline_mm
    then = np.roll(ahead, -1, axis=0)
    assert (ahead[:, 0] * then[:, 1] > ahead[:, 1] * then[:, 0]).all(), "it is convex"
    assert section.filled == pytest.approx(filled, rel=0.02)


@pytest.mark.parametrize(
    ("outline", "filled", "depth_mm", "message"),
    [
        (np.ones(4), 1.0, 0.1, r"finite xy in mm, \[n, 2\]"),
        (np.full((4, 2), math.nan), 1.0, 0.1, "finite"),
        (np.eye(2), 0.0, 0.1, r"a part of its outline in \(0, 1\]"),
        (np.eye(2), 1.0, 0.0, "above 0 mm"),
    ],
)
def test_a_section_is_checked(outline, filled, depth_mm, message):
    with pytest.raises(InputError, match=message):
        ToolSection(outline, filled, depth_mm)
