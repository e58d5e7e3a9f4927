# SPDX-License-Identifier: Apache-2.0
"""Meshes for one press: fine where the contact is, the same arrays wherever that is; thin gels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.mesh.quality import measure_quality
from taccel_lab.cad.parts.height_pad import MIN_WALL_MM
from taccel_lab.geometry import Region
from taccel_lab.geometry.contact_sweep import ContactSweep
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.model.embedding import rotate
from taccel_lab.presses import PressEnv, PressMeshOptions, PressSetup, normal_frame, parse_indenter
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.presses.mesh import pad_press_mesh, press_mesh, refined_press_mesh
from taccel_lab.presses.mesh_options import DEFAULT_PRESS_MESH
from taccel_lab.scene import Material
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import sensor_family
from tests.cad.pads import check_same, contact_edges
from tests.support.sensor_refusals import refuses

SMALL = PressMeshOptions(elements_per_radius=4.0, core=6, rings=10, layers=3)
RECTANGLE = np.array([[-0.1, -3.0], [0.1, -3.0], [0.1, 3.0], [-0.1, 3.0]])
TRIANGLE = np.array([[-2.5, -1.4], [2.5, -1.4], [0.0, 2.9]])
TURN = np.linspace(0, 2 * np.pi, 64, endpoint=False)
DISC = np.stack([np.cos(TURN), np.sin(TURN)], axis=1)


def section(outline_mm: np.ndarray, filled: float = 1.0) -> ToolSection:
    return ToolSection(outline_mm, filled, depth_mm=0.6)


@pytest.mark.parametrize("at_mm", [(0.0, 0.0), (4.0, -3.0)])
@pytest.mark.parametrize("radius", [0.6, 1.2])
def test_elements_are_fine_around_the_contact(at_mm: tuple[float, float], radius: float) -> None:
    options = PressMeshOptions(elements_per_radius=5.0, fine_radii=1.5, core=10, rings=16, layers=3)
    lengths, away = contact_edges(press_mesh("gelsight", {}, at_mm, radius, options), at_mm)
    near = lengths[away < 0.8 * radius]
    assert near.size > 20
    assert np.median(near) == pytest.approx(radius / 5, rel=0.5)
    assert np.median(lengths[away > 4 * radius]) > 2 * np.median(near)


def test_options_set_the_number_of_nodes_and_parameters_the_shape() -> None:
    changes = {"thickness_mm": 7.0, "length_x_mm": 30.0}
    for core, rings, layers in ((4, 8, 2), (6, 10, 3)):
        options = PressMeshOptions(core=core, rings=rings, layers=layers)
        mesh = press_mesh("gelsight", changes, (0.0, 0.0), 1.0, options)
        assert mesh.node_count == ((core + 1) ** 2 + 4 * core * rings) * (layers + 1)
        assert mesh.nodes_m[:, 2].min() == pytest.approx(-7e-3)
        assert np.ptp(mesh.nodes_m[:, 0]) == pytest.approx(30e-3)
    # A small contact on a thick gel has more layers and rings.
    thick = DEFAULT_PRESS_MESH.for_ball(0.22, 10.0, 12.5)
    assert thick.layers > DEFAULT_PRESS_MESH.layers and thick.rings > DEFAULT_PRESS_MESH.rings
    assert DEFAULT_PRESS_MESH.for_ball(1.5, 4.25, 11.5) == DEFAULT_PRESS_MESH
    # A contact wider than the gel is thick has smaller elements.
    thin = DEFAULT_PRESS_MESH.for_ball(1.3, 1.0, 12.5)
    assert thin.elements_per_radius > 1.3 * DEFAULT_PRESS_MESH.elements_per_radius


def test_places_and_ways_add_what_they_need() -> None:
    usual = DEFAULT_PRESS_MESH
    assert usual.for_edge(1.0, 3.1) == usual.for_sweep(1.0, 2.9) == usual
    assert usual.for_friction(0.46) == usual != usual.for_friction(0.48)
    assert usual.for_drag().outline.core > usual.outline.core
    beside = usual.for_edge(1.0, 2.0)
    assert beside.core > usual.core and beside.rings > usual.rings
    far, farther = usual.for_sweep(1.0, 5.0), usual.for_sweep(1.0, 9.0)
    assert usual.fine_radii < far.fine_radii < farther.fine_radii
    assert usual.core <= far.core < farther.core and far.rings <= farther.rings


def test_a_mesh_is_fine_along_the_whole_way() -> None:
    """A ball's about the middle of its way, under a rim where it ends."""
    pad = sensor_family("flat_pad").parameters({}).pad()
    way = ContactSweep((5.0, 0.0))
    mesh = refined_press_mesh(pad, (-2.5, 0.0), 1.1, sweep=way)
    for place in ((-2.5, 0.0), (0.0, 0.0), (2.5, 0.0)):
        lengths, away = contact_edges(mesh, place)
        assert np.median(lengths[away < 1.1]) < 0.9
    still = refined_press_mesh(pad, (-2.5, 0.0), 1.1)
    lengths, away = contact_edges(still, (2.5, 0.0))
    assert np.median(lengths[away < 1.1]) > 0.9
    punch = parse_indenter("cylinder:2").contact(0.3)
    top = refined_press_mesh(pad, (0.0, 0.0), punch, sweep=ContactSweep((1.0, 0.5)))
    faces = top.nodes_m[top.region_nodes(Region.CONTACT), :2] * 1e3
    rows = np.linalg.norm(faces - [1.0, 0.5], axis=1)
    polygon = 0.5 * 16 * math.sin(2 * math.pi / 16)
    assert (np.abs(rows - 2.0 * math.sqrt(math.pi / polygon)) < 0.005).sum() == 16


test_refused = refuses(
    lambda *given: press_mesh(*given, SMALL),
    ("digit9", {}, (0.0, 0.0), 1.0, r"digit9.*mean digit\?"),
    ("gelsight", {"thick": 3.0}, (0.0, 0.0), 1.0, "thick"),
    ("gelsight", {"thickness_mm": -3.0}, (0.0, 0.0), 1.0, r"thickness_mm.*-3"),
    ("gelsight", {}, (11.5, 0.0), 1.0, r"at_mm = \(11\.5, 0\).*at least 1\.5 mm"),
    ("gelsight", {}, (40.0, 0.0), 1.0, r"at_mm = \(40, 0\)"),
    ("gelsight", {}, (0.0, math.nan), 1.0, "at_mm"),
    ("gelsight", {}, (0.0, 0.0), 0.0, r"radius must be above 0 mm, got 0"),
    ("gelsight", {}, (11.5, 0.0), section(RECTANGLE), r"lies .* inside the pad's edge"),
    ("gelsight", {}, (0.0, 0.0), math.nan, "radius .* got nan"),
)


@pytest.mark.parametrize("outline", [RECTANGLE, TRIANGLE, 2 * DISC], ids=["long", "sharp", "round"])
def test_edges_of_the_mesh_lie_on_the_outline_and_are_short_across_it(outline: np.ndarray) -> None:
    mesh = press_mesh("flat_pad", {}, (1.0, -0.5), section(outline))
    corners = mesh.nodes_m[mesh.region_faces(Region.CONTACT)] * 1e3
    following = np.roll(corners, -1, axis=1)
    places = ((corners + following) / 2).reshape(-1, 3)[:, :2] - [1.0, -0.5]
    lengths = np.linalg.norm(following - corners, axis=-1).ravel()
    ahead = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    outside = ((places[:, None] - outline) * normal).sum(axis=2).max(axis=1)
    # Chords of a round one hold its area: their middles are 0.6 % inside.
    on = np.abs(outside) < 2e-3 + 0.007 * np.abs(outline).max(axis=0).min()
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
    st.sampled_from(["flat_pad", "gelsight_mini", "digit", "9dtact", "rtac", "digit_360"]),
    st.tuples(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0)),
    st.tuples(st.floats(0.05, 4.0), st.floats(0.05, 6.0)),
    st.floats(0.0, math.pi),
)
def test_outlines_of_any_shape_share_arrays(
    name: str, at_mm: tuple[float, float], half_mm: tuple[float, float], turn: float
) -> None:
    """Also those that reach beyond the pad."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half_mm
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    mesh = press_mesh(name, {}, at_mm, section(corners @ rotation))
    check_same(mesh, press_mesh(name, {}, (0.0, 0.0), section(1.5 * DISC)))
    assert (mesh.volumes_m3() > 0).all()


@pytest.mark.parametrize("name", ["rtac", "digit_360"])
@pytest.mark.parametrize("at", [(0.0, 0.0), (3.0, -2.0)])
def test_rings_on_a_dome_follow_the_outline(name: str, at: tuple[float, float]) -> None:
    outline, place = RECTANGLE * [1.0, 0.4], np.array(at)
    pad = sensor_family(name).parameters().pad()
    mesh = press_mesh(name, {}, at, section(outline))
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
    longest = []
    for filled in (1.0, 0.5):
        mesh = press_mesh("flat_pad", {}, (0.0, 0.0), section(2 * DISC, filled))
        lengths, away = contact_edges(mesh, (0.0, 0.0))
        longest.append(lengths[away < 1.0].max())
    assert longest[1] < 0.7 * longest[0]


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*as finely as elsewhere")
@pytest.mark.parametrize("lowest", [0.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_every_place_in_the_image_meshes(lowest: float) -> None:
    """12 of 81 were refused; a quarter of the image has three of them."""
    grid = catalogue_profile("gelsight_r15").grid()
    half = 0.475 * np.array([grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y])
    parts = np.linspace(-1, 1, 9)
    parts = parts[parts >= lowest]
    for x, y in (half * np.stack(np.meshgrid(parts, parts), axis=-1).reshape(-1, 2)).tolist():
        press_mesh("gelsight_r15", {}, (x, y), 1.5)
    # A narrower focus is taken where the usual one folds.
    with pytest.warns(UserWarning, match=r"fine part is \d+% as wide"):
        beside = press_mesh("gelsight_r15", {}, (0.0, 13.33), 2.1)
    check_same(beside, press_mesh("gelsight_r15", {}, (0.0, 0.0), 2.1))


@pytest.mark.thorough(cases=("9dtact-0.8", "9dtact-1.0", "9dtact-2.0"))
@pytest.mark.parametrize("thickness_mm", [0.8, 1.0, 2.0])
@pytest.mark.parametrize("name", ["digit", "9dtact", "flat_pad"])
def test_thin_gels_mesh_well(name: str, thickness_mm: float) -> None:
    pad = sensor_family(name).parameters({"thickness_mm": thickness_mm}).pad()
    assert pad.figures()["wall_height_min"] >= MIN_WALL_MM
    assert measure_quality(gel_mesh(pad), pad).min_dihedral_deg > 10


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("tool", "poisson"),
    [
        pytest.param("sphere:2", 0.46, marks=pytest.mark.slow),
        pytest.param("sphere:4", 0.46, marks=pytest.mark.slow),
        ("sphere:2", 0.499),
    ],
)
def test_a_ball_on_a_gel_of_0_8_mm_feels_the_closed_form(tool: str, poisson: float) -> None:
    pad = sensor_family("flat_pad").parameters({"thickness_mm": 0.8}).pad()
    indenter = parse_indenter(tool)
    mesh = pad_press_mesh(pad, (0.0, 0.0), indenter.contact(0.16))
    env = PressEnv(PressSetup(mesh, Material(1e5, poisson), indenter), np.zeros((1, 2)))
    for depth in (0.08, 0.16):
        report = env.try_to(np.array([depth]), np.zeros((1, 2)), 0.0, stay=np.zeros(1, dtype=bool))
        assert report.converged.all()
        force = layer_force_n("sphere", np.array([depth]), float(tool[-1]), 0.8, poisson, 1e5)[0]
        assert env.wrench[0, 2] == pytest.approx(force, rel=0.03)
