# SPDX-License-Identifier: Apache-2.0
"""Meshes for one press: fine where the contact is, the same arrays wherever that is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.model.embedding import rotate
from taccel_lab.presses import PressMeshOptions, normal_frame
from taccel_lab.sensors.press_mesh import press_mesh
from taccel_lab.sensors.registry import sensor_family

SMALL = PressMeshOptions(elements_per_radius=4.0, core=6, rings=10, layers=3)


def section(outline_mm: np.ndarray, filled: float = 1.0) -> ToolSection:
    return ToolSection(outline_mm, filled, depth_mm=0.6)


RECTANGLE = np.array([[-0.1, -3.0], [0.1, -3.0], [0.1, 3.0], [-0.1, 3.0]])
TRIANGLE = np.array([[-2.5, -1.4], [2.5, -1.4], [0.0, 2.9]])


def contact_edges(mesh: TetMesh) -> tuple[np.ndarray, np.ndarray]:
    """Midpoints [mm] and lengths [mm] of the contact face's edges."""
    corners = mesh.nodes_m[mesh.region_faces(Region.CONTACT)] * 1e3
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    return ends.mean(axis=1), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


@pytest.mark.thorough
@settings(max_examples=8)
@given(x=st.floats(-7.5, 7.5), y=st.floats(-5.5, 5.5), radius=st.floats(0.5, 1.6))
def test_shape_is_that_of_the_pad_and_arrays_are_shared(x: float, y: float, radius: float) -> None:
    mesh = press_mesh("gelsight", {}, (x, y), radius, SMALL)
    middle = press_mesh("gelsight", {}, (0.0, 0.0), 1.0, SMALL)
    assert np.array_equal(mesh.tets, middle.tets)
    assert np.array_equal(mesh.faces, middle.faces)
    assert np.array_equal(mesh.face_regions, middle.face_regions)
    pad = sensor_family("gelsight").parameters().pad()
    top = mesh.nodes_m[mesh.region_nodes(Region.CONTACT)] * 1e3
    assert top[:, 2] == pytest.approx(pad.height_mm(top[:, :2]), abs=1e-9)
    assert mesh.nodes_m[mesh.bonded_nodes(), 2] == pytest.approx(-5e-3, abs=1e-15)
    low, high = mesh.nodes_m.min(axis=0), mesh.nodes_m.max(axis=0)
    assert high[:2] - low[:2] == pytest.approx([24e-3, 20e-3])
    assert dihedral_angles_deg(mesh.nodes_m, mesh.tets).min() > 1.0


@pytest.mark.parametrize("at_mm", [(0.0, 0.0), (4.0, -3.0)])
@pytest.mark.parametrize("radius", [0.6, 1.2])
def test_elements_are_fine_around_the_contact(at_mm: tuple[float, float], radius: float) -> None:
    options = PressMeshOptions(elements_per_radius=5.0, fine_radii=1.5, core=10, rings=16, layers=3)
    places, lengths = contact_edges(press_mesh("gelsight", {}, at_mm, radius, options))
    away = np.linalg.norm(places[:, :2] - at_mm, axis=1)
    near = lengths[away < 0.8 * radius]
    assert len(near) > 20
    assert np.median(near) == pytest.approx(radius / 5, rel=0.5)
    assert np.median(lengths[away > 4 * radius]) > 2 * np.median(near)


def test_options_set_the_number_of_nodes_and_parameters_the_shape() -> None:
    changes = {"thickness_mm": 7.0, "length_x_mm": 30.0}
    for core, rings, layers in ((4, 8, 2), (6, 10, 3)):
        options = PressMeshOptions(core=core, rings=rings, layers=layers)
        mesh = press_mesh("gelsight", changes, (0.0, 0.0), 1.0, options)
        plan = (core + 1) ** 2 + 4 * core * rings
        assert mesh.node_count == plan * (layers + 1)
        assert mesh.nodes_m[:, 2].min() == pytest.approx(-7e-3)
        assert np.ptp(mesh.nodes_m[:, 0]) == pytest.approx(30e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("digit9", {}, (0.0, 0.0), 1.0), r"digit9.*gelsight"),
        (("gelsight", {"thick": 3.0}, (0.0, 0.0), 1.0), "thick"),
        (("gelsight", {"thickness_mm": -3.0}, (0.0, 0.0), 1.0), r"thickness_mm.*-3"),
        (("gelsight", {}, (11.5, 0.0), 1.0), r"at_mm = \(11\.5, 0\).*at least 1\.5 mm"),
        (("gelsight", {}, (40.0, 0.0), 1.0), r"at_mm = \(40, 0\)"),
        (("gelsight", {}, (0.0, math.nan), 1.0), "at_mm"),
        (("gelsight", {}, (0.0, 0.0), 0.0), r"radius must be above 0 mm, got 0"),
        (("gelsight", {}, (11.5, 0.0), section(RECTANGLE)), r"lies .* inside the pad's edge"),
        (("gelsight", {}, (0.0, 0.0), math.nan), "radius .* got nan"),
    ],
)
def test_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        press_mesh(*arguments, SMALL)


def disc(radius_mm: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    return radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize(
    "outline", [RECTANGLE, TRIANGLE, disc(2.0)], ids=["long", "sharp", "round"]
)
def test_edges_of_the_mesh_lie_on_the_outline_and_are_short_across_it(outline: np.ndarray) -> None:
    at_mm = np.array([1.0, -0.5])
    mesh = press_mesh("flat_pad", {}, (1.0, -0.5), section(outline))
    places, lengths = contact_edges(mesh)
    ahead = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    outside = ((places[:, None, :2] - at_mm - outline) * normal).sum(axis=2).max(axis=1)
    on = np.abs(outside) < 2e-3
    # Edges on the outline go all around; each is that of two faces.
    assert lengths[on].sum() / 2 == pytest.approx(np.linalg.norm(ahead, axis=1).sum(), rel=0.03)
    size = math.sqrt(np.prod(np.abs(outline).max(axis=0)))
    # The uppermost layer is a tenth of the mean of size and thickness, the first ring 0.6 of that.
    step = 0.06 * math.sqrt(4.0 * size)
    beside = lengths[(outside > 5e-3) & (outside < step)]
    assert beside.min() < 1.05 * step


@pytest.mark.thorough
@settings(max_examples=4)
@given(
    name=st.sampled_from(["flat_pad", "gelsight_mini", "digit", "9dtact", "rtac", "digit_360"]),
    x=st.floats(-6.0, 6.0),
    y=st.floats(-6.0, 6.0),
    wide=st.floats(0.05, 4.0),
    long=st.floats(0.05, 6.0),
    turn=st.floats(0.0, math.pi),
)
def test_outlines_of_any_shape_share_arrays(
    name: str, x: float, y: float, wide: float, long: float, turn: float
) -> None:
    """Also those that reach beyond the pad."""
    corners = np.array([[-wide, -long], [wide, -long], [wide, long], [-wide, long]])
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    mesh = press_mesh(name, {}, (x, y), section(corners @ rotation))
    plain = press_mesh(name, {}, (0.0, 0.0), section(disc(1.5)))
    assert np.array_equal(mesh.tets, plain.tets)
    assert np.array_equal(mesh.face_regions, plain.face_regions)
    assert (mesh.volumes_m3() > 0).all()


@pytest.mark.parametrize("name", ["rtac", "digit_360"])
@pytest.mark.parametrize("at", [(0.0, 0.0), (3.0, -2.0)])
def test_rings_on_a_dome_follow_the_outline(name: str, at: tuple[float, float]) -> None:
    outline = RECTANGLE * [1.0, 0.4]
    pad = sensor_family(name).parameters().pad()
    mesh = press_mesh(name, {}, at, section(outline))
    place = np.array(at)
    frame = normal_frame(np.append(place, pad.top_mm(place)), pad.top_normal(place))
    places = mesh.nodes_m[np.unique(mesh.region_faces(Region.CONTACT))] * 1e3 - frame[:3]
    local = np.abs(rotate(frame[3:] * [-1, -1, -1, 1], places))
    from_sides = local[:, :2] - np.abs(outline).max(axis=0)
    on = np.abs(from_sides.max(axis=1)) < 5e-3
    # A node for each of the 16 spokes, at the height of the dome.
    assert on.sum() == 16
    assert local[on, 2].max() < 0.1


def test_tools_full_of_gaps_have_even_cells_inside() -> None:
    """Where the gaps are no ring can know; the same outline, filled, has rings at its border."""
    outline = disc(2.0)
    inside = []
    for filled in (1.0, 0.5):
        mesh = press_mesh("flat_pad", {}, (0.0, 0.0), section(outline, filled))
        places, lengths = contact_edges(mesh)
        inside.append(lengths[np.linalg.norm(places[:, :2], axis=1) < 1.0].max())
    assert inside[1] < 0.7 * inside[0]
