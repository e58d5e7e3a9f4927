# SPDX-License-Identifier: Apache-2.0
"""Structured meshes of pads with a plane back: gate, sweeps, layers; gels known by their mesh."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh, gel_mesh
from taccel_lab.cad.mesh.mesh_pad import MeshPad
from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg
from taccel_lab.cad.mesh.surface import check_closed
from taccel_lab.cad.mesh.tet_smoothing import improve_worst_tets
from taccel_lab.cad.parts.digit_pad import DigitPad
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad_solid import layer_solids
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from tests.cad.pads import BEVELLED, DIGIT, MINI, PADS, SKINNED, gel_pads

CLASSIC = PADS["gelsight"]
FLAT_FILLET = GelPad(
    length_x_mm=20, length_y_mm=16, corner_radius_mm=2, thickness_mm=5, rim="fillet",
    rim_mm=0.5, rim_radius_mm=5, window_x_mm=10, window_y_mm=8,
)  # fmt: skip


def around(at_mm: tuple[float, float], radius: float = 2.0, size: float = 0.25) -> FocusOptions:
    return FocusOptions(at_mm, radius, size, core=8, rings=10)


def check_invariants(mesh: TetMesh, pad: GelPad) -> None:
    check_sound(mesh, pad)
    assert np.array_equal(np.unique(mesh.tets), np.arange(mesh.node_count))
    boundary = mesh.nodes_m[mesh.faces]
    enclosed = (boundary[:, 0] * np.cross(boundary[:, 1], boundary[:, 2])).sum() / 6
    assert enclosed == pytest.approx(mesh.volumes_m3().sum(), rel=1e-9)

    bonded = mesh.nodes_m[mesh.bonded_nodes()]
    assert np.unique(bonded[:, 2]).size == 1
    assert bonded[0, 2] == pytest.approx(-pad.thickness_mm * 1e-3, rel=1e-15)
    assert (mesh.nodes_m[:, 2] >= bonded[0, 2]).all()
    contact = mesh.nodes_m[mesh.region_nodes(Region.CONTACT)] * 1e3
    off = np.abs(contact[:, 2] - pad.height_mm(contact[:, :2]))
    # A fillet is upright at the wall: 1e-15 mm beside it is 1e-7 mm above its foot.
    foot = pad.has_fillet & (np.abs(pad.inside_distance_mm(contact[:, :2])) < 1e-12)
    assert off[~foot].max(initial=0.0) < 1e-11
    assert off[foot].max(initial=0.0) < 2e-6
    side = mesh.nodes_m[mesh.region_nodes(Region.SIDE)] * 1e3
    np.testing.assert_allclose(pad.inside_distance_mm(side[:, :2]), 0, atol=1e-9)


@pytest.mark.thorough
@given(gel_pads(), st.floats(2.2, 3.0))
@example(replace(FLAT_FILLET, length_x_mm=33.5, window_x_mm=16.75), 2.6)
@settings(max_examples=3, deadline=None)
def test_even_meshes_are_sound(pad: GelPad, edge_mm: float) -> None:
    mesh = gel_mesh(pad, edge_mm)
    check_invariants(mesh, pad)
    window = mesh.nodes_m[mesh.region_faces(Region.WINDOW)] * 1e3
    area = np.linalg.norm(
        np.cross(window[:, 1] - window[:, 0], window[:, 2] - window[:, 0]), axis=1
    )
    assert area.sum() / 2 == pytest.approx(pad.window_x_mm * pad.window_y_mm, rel=1e-9)


@pytest.mark.thorough
@given(gel_pads(), st.floats(-1, 1), st.floats(-1, 1), st.floats(0.8, 2.2), st.floats(0.1, 0.2))
@settings(max_examples=6, deadline=None)
def test_focused_meshes_are_sound(
    pad: GelPad, u: float, v: float, radius_mm: float, relative_size: float
) -> None:
    focus = (u * (pad.length_x_mm / 2 - 4), v * (pad.length_y_mm / 2 - 4))
    assume(pad.inside_distance_mm(np.array(focus)) - pad.rim_setback_mm() > 3)
    mesh = focused_gel_mesh(pad, around(focus, radius_mm, relative_size * radius_mm))
    check_invariants(mesh, pad)


@pytest.mark.parametrize("focus", [(0, 0), (3, 2), (7.04, -3.05), (-6.5, -4.1), (-6.6, 3.6)])
def test_focus_has_the_wanted_elements(focus: tuple[float, float]) -> None:
    size = 0.25
    mesh = focused_gel_mesh(CLASSIC, around(focus, 2.0, size))
    assert 1900 < mesh.node_count < 2100
    faces = mesh.region_faces(Region.CONTACT)
    corners = mesh.nodes_m[faces] * 1e3
    length = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    near = np.linalg.norm(corners.mean(axis=1)[:, :2] - focus, axis=1)
    # Diagonals and the fan of the spokes lengthen edges; the finest quarter is the wanted size.
    assert np.quantile(length[near < 1.5], 0.25) == pytest.approx(size, rel=0.3)
    assert length[near < 1.5].max() < 3.2 * size
    assert np.median(length[near > 6]) > 4 * size


@pytest.mark.thorough
def test_mesh_volume_converges_to_the_pad() -> None:
    # Volume of the spherical dome over the rounded rectangle, by midpoint rule.
    cells = 2000
    axes = [(np.arange(cells) + 0.5) / cells * length - length / 2 for length in (24.0, 20.0)]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    exact = ((CLASSIC.height_mm(xy) + 5) * (CLASSIC.inside_distance_mm(xy) > 0)).mean() * 480
    errors = [
        1 - gel_mesh(CLASSIC, edge).volumes_m3().sum() * 1e9 / exact for edge in (3.0, 1.7, 0.9)
    ]
    assert 0 < errors[2] < errors[1] < errors[0] < 0.02
    assert errors[2] < 1e-3


def test_same_input_gives_the_same_bytes() -> None:
    meshes = [focused_gel_mesh(CLASSIC, around((2.2, -1.7))) for _ in range(2)]
    assert meshes[0].nodes_m.tobytes() == meshes[1].nodes_m.tobytes()


def check_sound(mesh: TetMesh, pad: HeightPad) -> None:
    assert (mesh.volumes_m3() > 0).all()
    check_closed(mesh.faces, "boundary")
    nodes = mesh.nodes_m * 1e3
    bonded = nodes[mesh.bonded_nodes()]
    assert np.linalg.norm(bonded - pad.bond_projection_mm(bonded), axis=1).max() < 1e-9
    contact = nodes[mesh.region_nodes(Region.CONTACT)]
    # Where a fillet meets the wall the formula is infinitely steep.
    steep = pad.inside_distance_mm(contact[:, :2]) < 1e-3
    assert pad.contact_error_mm(contact)[~steep].max() < 1e-6


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"core": 7}, "core = 7"),
        ({"core": 2}, "core = 2 is not allowed"),
        ({"core": 8.0}, "core"),
        ({"rings": 2}, "rings = 2"),
        ({"layers": 0}, "layers = 0"),
        ({"layer_ratio": 0.5}, "layer_ratio"),
        ({"at_mm": (11.5, 0)}, "at least 1.5 mm"),
        ({"at_mm": (50, 0)}, "at least 1.5 mm"),
        ({"at_mm": (float("nan"), 0)}, "at_mm"),
        ({"radius_mm": -1}, "radius_mm"),
        ({"size_mm": 5}, "size_mm"),
    ],
)
def test_bad_options_say_what_is_allowed(options: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word):
        focused_gel_mesh(CLASSIC, replace(around((0, 0)), **options))  # type: ignore[arg-type]


@pytest.mark.thorough
@given(st.floats(3.6, 6), st.floats(22, 28), st.floats(18, 24), st.floats(90, 300), st.floats(2, 4))
@settings(max_examples=2, deadline=None)
def test_minis_of_a_sweep_share_their_connectivity(
    thickness: float, length_x: float, length_y: float, radius: float, rim: float
) -> None:
    pad = replace(
        MINI, thickness_mm=thickness, length_x_mm=length_x, length_y_mm=length_y, rim_mm=rim,
        crown_radius_x_mm=radius, wall_mm=0.6 * thickness, window_x_mm=0.75 * length_x,
        window_y_mm=0.7 * length_y,
    )  # fmt: skip
    mesh = gel_mesh(pad, 1.6, counts_of=MINI)
    check_same(mesh, gel_mesh(MINI, 1.6))
    check_sound(mesh, pad)


@pytest.mark.thorough
def test_digits_of_a_sweep_share_their_connectivity() -> None:
    pad = DigitPad(mid_radius_mm=30.0, thickness_mm=5.1, length_mm=27.0)
    mesh = gel_mesh(pad, counts_of=DIGIT)
    check_same(mesh, gel_mesh(DIGIT))
    check_sound(mesh, pad)


def check_same(mesh: TetMesh, other: TetMesh) -> None:
    for name in ("tets", "faces", "face_regions", "tet_layers"):
        assert getattr(mesh, name).tobytes() == getattr(other, name).tobytes()
    assert mesh.nodes_m.shape == other.nodes_m.shape


@pytest.mark.thorough
def test_bevels_wider_than_the_margin_do_not_fold() -> None:
    pad = GelPad(
        length_x_mm=17, length_y_mm=24.6, corner_radius_mm=0.3, thickness_mm=5.7, rim="chamfer",
        rim_mm=2.96, wall_mm=4.07, window_x_mm=13.4, window_y_mm=12.4,
    )  # fmt: skip
    check_sound(gel_mesh(pad, 1.5), pad)


@pytest.mark.thorough(cases=("False",))
@pytest.mark.parametrize("focused", [False, True])
def test_tets_do_not_cross_from_gel_to_skin(focused: bool) -> None:
    options = FocusOptions((3, -2), 2.0, 0.3, core=8, rings=12)
    mesh = focused_gel_mesh(SKINNED, options) if focused else gel_mesh(SKINNED, 1.5)
    check_sound(mesh, SKINNED)
    nodes = mesh.nodes_m * 1e3
    corners = nodes[mesh.tets]
    for weights in (np.full(4, 0.25), np.array([0.97, 0.01, 0.01, 0.01])):
        inside = (corners * weights[:, None]).sum(axis=1)
        # Chords of the interface's corner arcs miss them by their sagitta.
        clear = np.abs(SKINNED.inside_distance_mm(inside[:, :2]) - 0.8) > 0.15
        assert clear.mean() > 0.7
        np.testing.assert_array_equal(SKINNED.layer_of(inside)[clear], mesh.tet_layers[clear])
    skin = mesh.volumes_m3()[mesh.tet_layers == 1].sum() * 1e9
    solid = layer_solids(SKINNED)["skin"].volume
    assert skin == pytest.approx(solid, rel=0.05 if focused else 5e-3)


@pytest.mark.thorough
def test_glued_walls_are_bond_faces() -> None:
    for mesh in (
        gel_mesh(BEVELLED, 2.5),
        focused_gel_mesh(BEVELLED, FocusOptions((5, -3), 3.0, 0.5, core=8, rings=12)),
    ):
        check_sound(mesh, BEVELLED)
        assert not (mesh.face_regions == int(Region.SIDE)).any()
        wall = mesh.nodes_m[mesh.bonded_nodes()] * 1e3
        assert wall[:, 2].max() == pytest.approx(-2.954, abs=0.1)


def test_counts_of_a_dome_and_no_edge_are_refused() -> None:
    with pytest.raises(InputError, match="counts_of"):
        gel_mesh(MINI, counts_of=ShellDomePad())
    with pytest.raises(InputError, match="edge_mm"):
        gel_mesh(MINI, 0.0)


def test_smoothing_pulls_folded_tets_open() -> None:
    mesh = gel_mesh(MINI, 2.7)
    nodes = mesh.nodes_m * 1e3
    inner = np.setdiff1d(np.arange(mesh.node_count), np.unique(mesh.faces))
    folded = nodes.copy()
    moved = inner[:: max(1, len(inner) // 3)]
    folded[moved] += [1.5, 0.8, 0.9]

    def signed(x: np.ndarray) -> np.ndarray:
        p = x[mesh.tets]
        return np.linalg.det(p[:, 1:] - p[:, :1])

    assert (signed(folded) < 0).any()
    opened = improve_worst_tets(folded, mesh.tets, inner, wanted_deg=8, powers=(4, 4, 8))
    assert (signed(opened) > 0).all()
    assert dihedral_angles_deg(opened, mesh.tets).min() > 3
    held = np.setdiff1d(np.arange(mesh.node_count), inner)
    np.testing.assert_array_equal(opened[held], folded[held])


BOX = GelPad(
    length_x_mm=16, length_y_mm=14, corner_radius_mm=1.5, thickness_mm=4, window_x_mm=10,
    window_y_mm=9, crown_radius_x_mm=40, crown_radius_y_mm=60,
)  # fmt: skip


@pytest.fixture(scope="module")
def meshed() -> MeshPad:
    return MeshPad(BOX.thickness_mm, mesh=gel_mesh(BOX, 0.7))


def test_surfaces_of_the_mesh_are_those_of_the_formulas(meshed: MeshPad) -> None:
    xy = np.stack(np.meshgrid(np.linspace(-7, 7, 23), np.linspace(-6, 6, 19)), axis=-1)
    # Chords of 0.7 mm on a radius of 40 mm lie 0.7^2 / (8 * 40) = 0.0015 mm deep.
    assert meshed.top_mm(xy) == pytest.approx(BOX.top_mm(xy), abs=6e-3)
    inner = (np.abs(xy) < 5).all(axis=-1)
    cosine = (meshed.top_normal(xy) * BOX.top_normal(xy)).sum(axis=-1)[inner]
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.3
    assert meshed.bounds_mm() == pytest.approx(BOX.bounds_mm(), abs=1e-6)
    assert np.isnan(meshed.top_mm(np.array([20.0, 0.0])))
    assert np.isnan(meshed.top_normal(np.array([20.0, 0.0]))).all()


def test_distance_to_the_edge_has_the_sign_of_the_side(meshed: MeshPad) -> None:
    xy = np.array([[0.0, 0.0], [6.0, 0.0], [0.0, -6.5], [11.0, 0.0], [0.0, 9.0]])
    assert meshed.inside_distance_mm(xy) == pytest.approx(BOX.inside_distance_mm(xy), abs=0.05)
    assert meshed.inside_distance_mm(xy[:1]).shape == (1,)


def test_glued_and_touched_surfaces_and_the_volume(meshed: MeshPad) -> None:
    points = np.array([[1.0, 2.0, -3.5], [0.0, 0.0, -5.0]])
    assert meshed.bond_projection_mm(points) == pytest.approx(BOX.bond_projection_mm(points))
    above = np.array([[0.0, 0.0, 0.2]])
    assert meshed.contact_error_mm(above) == pytest.approx([0.2], abs=4e-3)
    volume = 1e9 * meshed.mesh.volumes_m3().sum()
    assert meshed.figures() == {"volume_mm3": pytest.approx(volume)}


def test_equal_gels_have_one_name_and_others_another(meshed: MeshPad) -> None:
    assert repr(pickle.loads(pickle.dumps(meshed))) == repr(meshed)
    assert repr(MeshPad(BOX.thickness_mm, mesh=gel_mesh(BOX, 0.9))) != repr(meshed)
    assert gel_mesh(meshed) is meshed.mesh
