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
from taccel_lab.cad.mesh.tet_smoothing import improve_worst_tets
from taccel_lab.cad.parts.digit_pad import DigitPad
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad_solid import layer_solids
from taccel_lab.geometry import Region, TetMesh
from tests.cad import pads
from tests.support.sensor_refusals import refuses

FLAT_FILLET = GelPad(
    length_x_mm=33.5, length_y_mm=16, corner_radius_mm=2, thickness_mm=5, rim="fillet",
    rim_mm=0.5, rim_radius_mm=5, window_x_mm=16.75, window_y_mm=8,
)  # fmt: skip


def around(at_mm: tuple[float, float], radius: float = 2.0, size: float = 0.25) -> FocusOptions:
    return FocusOptions(at_mm, radius, size, core=8, rings=10)


def check_invariants(mesh: TetMesh, pad: GelPad) -> None:
    pads.check_sound(mesh, pad)
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
@given(pads.gel_pads(), st.floats(2.2, 3.0))
@example(FLAT_FILLET, 2.6)
@settings(max_examples=3)
def test_even_meshes_are_sound(pad: GelPad, edge_mm: float) -> None:
    mesh = gel_mesh(pad, edge_mm)
    check_invariants(mesh, pad)
    a, b, c = (mesh.nodes_m[mesh.region_faces(Region.WINDOW)] * 1e3).transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(pad.window_x_mm * pad.window_y_mm, rel=1e-9)


@pytest.mark.thorough
@given(pads.gel_pads(), *2 * [st.floats(-1, 1)], st.floats(0.8, 2.2), st.floats(0.1, 0.2))
@settings(max_examples=6)
def test_focused_meshes_are_sound(
    pad: GelPad, u: float, v: float, radius_mm: float, relative_size: float
) -> None:
    focus = (u * (pad.length_x_mm / 2 - 4), v * (pad.length_y_mm / 2 - 4))
    assume(pad.inside_distance_mm(np.array(focus)) - pad.rim_setback_mm() > 3)
    options = around(focus, radius_mm, relative_size * radius_mm)
    check_invariants(focused_gel_mesh(pad, options), pad)


@pytest.mark.parametrize("focus", [(0, 0), (3, 2), (7.04, -3.05), (-6.5, -4.1), (-6.6, 3.6)])
def test_focus_has_the_wanted_elements(focus: tuple[float, float]) -> None:
    size = 0.25
    mesh = focused_gel_mesh(pads.CLASSIC, around(focus, 2.0, size))
    assert 1900 < mesh.node_count < 2100
    length, near = pads.contact_edges(mesh, focus)
    # Diagonals and the fan of the spokes lengthen edges; the finest quarter is the wanted size.
    assert np.quantile(length[near < 1.5], 0.25) == pytest.approx(size, rel=0.3)
    assert length[near < 1.5].max() < 3.2 * size
    assert np.median(length[near > 6]) > 4 * size
    again = focused_gel_mesh(pads.CLASSIC, around(focus, 2.0, size))
    assert again.nodes_m.tobytes() == mesh.nodes_m.tobytes()


test_bad_options_say_what_is_allowed = refuses(
    lambda options: focused_gel_mesh(pads.CLASSIC, replace(around((0, 0)), **options)),
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
)
test_bad_counts_and_edges_are_refused = refuses(
    lambda options: gel_mesh(pads.MINI, **options),
    ({"counts_of": ShellDomePad()}, "counts_of"),
    ({"edge_mm": 0.0}, "edge_mm"),
)


@pytest.mark.thorough
@given(st.floats(3.6, 6), st.floats(22, 28), st.floats(18, 24), st.floats(90, 300), st.floats(2, 4))
@settings(max_examples=2)
def test_minis_of_a_sweep_share_their_connectivity(
    thickness: float, length_x: float, length_y: float, radius: float, rim: float
) -> None:
    pad = replace(
        pads.MINI, thickness_mm=thickness, length_x_mm=length_x, length_y_mm=length_y, rim_mm=rim,
        crown_radius_x_mm=radius, wall_mm=0.6 * thickness, window_x_mm=0.75 * length_x,
        window_y_mm=0.7 * length_y,
    )  # fmt: skip
    mesh = gel_mesh(pad, 1.6, counts_of=pads.MINI)
    pads.check_same(mesh, gel_mesh(pads.MINI, 1.6))
    pads.check_sound(mesh, pad)


@pytest.mark.thorough
def test_a_digit_of_a_sweep_and_a_wide_bevel_are_sound() -> None:
    digit = DigitPad(mid_radius_mm=30.0, thickness_mm=5.1, length_mm=27.0)
    mesh = gel_mesh(digit, counts_of=pads.DIGIT)
    pads.check_same(mesh, gel_mesh(pads.DIGIT))
    pads.check_sound(mesh, digit)
    bevelled = GelPad(
        length_x_mm=17, length_y_mm=24.6, corner_radius_mm=0.3, thickness_mm=5.7, rim="chamfer",
        rim_mm=2.96, wall_mm=4.07, window_x_mm=13.4, window_y_mm=12.4,
    )  # fmt: skip
    pads.check_sound(gel_mesh(bevelled, 1.5), bevelled)


def meshed(pad: HeightPad, focused: bool, edge_mm: float) -> TetMesh:
    options = FocusOptions((3, -2), 2.0, 0.3, core=8, rings=12)
    return focused_gel_mesh(pad, options) if focused else gel_mesh(pad, edge_mm)


@pytest.mark.thorough(cases=("False",))
@pytest.mark.parametrize("focused", [False, True])
def test_tets_do_not_cross_from_gel_to_skin(focused: bool) -> None:
    mesh = meshed(pads.SKINNED, focused, 1.5)
    pads.check_sound(mesh, pads.SKINNED)
    corners = mesh.nodes_m[mesh.tets] * 1e3
    for weights in (np.full(4, 0.25), np.array([0.97, 0.01, 0.01, 0.01])):
        inside = (corners * weights[:, None]).sum(axis=1)
        # Chords of the interface's corner arcs miss them by their sagitta.
        clear = np.abs(pads.SKINNED.inside_distance_mm(inside[:, :2]) - 0.8) > 0.15
        assert clear.mean() > 0.7
        np.testing.assert_array_equal(pads.SKINNED.layer_of(inside)[clear], mesh.tet_layers[clear])
    skin = mesh.volumes_m3()[mesh.tet_layers == 1].sum() * 1e9
    solid = layer_solids(pads.SKINNED)["skin"].volume
    assert skin == pytest.approx(solid, rel=0.05 if focused else 5e-3)


@pytest.mark.thorough
@pytest.mark.parametrize("focused", [False, True])
def test_glued_walls_are_bond_faces(focused: bool) -> None:
    mesh = meshed(pads.BEVELLED, focused, 2.5)
    pads.check_sound(mesh, pads.BEVELLED)
    assert not (mesh.face_regions == int(Region.SIDE)).any()
    wall = mesh.nodes_m[mesh.bonded_nodes()] * 1e3
    assert wall[:, 2].max() == pytest.approx(-2.954, abs=0.1)


def test_smoothing_pulls_folded_tets_open() -> None:
    mesh = gel_mesh(pads.MINI, 2.7)
    nodes = mesh.nodes_m * 1e3
    inner = np.setdiff1d(np.arange(mesh.node_count), np.unique(mesh.faces))
    folded = nodes.copy()
    folded[inner[:: max(1, len(inner) // 3)]] += [1.5, 0.8, 0.9]

    def signed(x: np.ndarray) -> np.ndarray:
        p = x[mesh.tets]
        return np.linalg.det(p[:, 1:] - p[:, :1])

    assert (signed(folded) < 0).any()
    opened = improve_worst_tets(folded, mesh.tets, inner, wanted_deg=8, powers=(4, 4, 8))
    assert (signed(opened) > 0).all()
    assert dihedral_angles_deg(opened, mesh.tets).min() > 3
    held = np.setdiff1d(np.arange(mesh.node_count), inner)
    np.testing.assert_array_equal(opened[held], folded[held])


def test_a_pad_of_a_mesh_has_the_surfaces_of_the_formulas_and_a_name() -> None:
    box = GelPad(
        length_x_mm=16, length_y_mm=14, corner_radius_mm=1.5, thickness_mm=4, window_x_mm=10,
        window_y_mm=9, crown_radius_x_mm=40, crown_radius_y_mm=60,
    )  # fmt: skip
    pad = MeshPad(box.thickness_mm, mesh=gel_mesh(box, 0.7))
    xy = np.stack(np.meshgrid(np.linspace(-7, 7, 23), np.linspace(-6, 6, 19)), axis=-1)
    # Chords of 0.7 mm on a radius of 40 mm lie 0.7^2 / (8 * 40) = 0.0015 mm deep.
    assert pad.top_mm(xy) == pytest.approx(box.top_mm(xy), abs=6e-3)
    inner = (np.abs(xy) < 5).all(axis=-1)
    cosine = (pad.top_normal(xy) * box.top_normal(xy)).sum(axis=-1)[inner]
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.3
    assert pad.bounds_mm() == pytest.approx(box.bounds_mm(), abs=1e-6)
    beside = np.array([20.0, 0.0])
    assert np.isnan(pad.top_mm(beside)) and np.isnan(pad.top_normal(beside)).all()

    xy = np.array([[0.0, 0.0], [6.0, 0.0], [0.0, -6.5], [11.0, 0.0], [0.0, 9.0]])
    assert pad.inside_distance_mm(xy) == pytest.approx(box.inside_distance_mm(xy), abs=0.05)
    assert pad.inside_distance_mm(xy[:1]).shape == (1,)

    points = np.array([[1.0, 2.0, -3.5], [0.0, 0.0, -5.0]])
    assert pad.bond_projection_mm(points) == pytest.approx(box.bond_projection_mm(points))
    assert pad.contact_error_mm(np.array([[0.0, 0.0, 0.2]])) == pytest.approx([0.2], abs=4e-3)
    assert pad.figures() == {"volume_mm3": pytest.approx(1e9 * pad.mesh.volumes_m3().sum())}
    # Equal gels have one name, others another.
    assert repr(pickle.loads(pickle.dumps(pad))) == repr(pad)
    assert repr(MeshPad(box.thickness_mm, mesh=gel_mesh(box, 0.9))) != repr(pad)
    assert gel_mesh(pad) is pad.mesh
