# SPDX-License-Identifier: Apache-2.0
"""Even meshes of every catalogue pad with a flat back: the quality gate, sweeps, layers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from catalogue_pads import BEVELLED, DIGIT, MINI, PADS, SKINNED
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh, gel_mesh
from taccel_lab.cad.mesh.quality import measure_quality
from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg
from taccel_lab.cad.mesh.surface import check_closed
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.mesh.tet_smoothing import improve_worst_tets
from taccel_lab.cad.parts.digit_pad import DigitPad
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad_solid import labelled_solid, layer_solids
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh


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


@pytest.mark.parametrize("name", list(PADS))
def test_catalogue_pads_pass_the_gate_at_the_default_resolution(name: str) -> None:
    pad = PADS[name]
    part = labelled_solid(pad)
    mesh = gel_mesh(pad)
    check_sound(mesh, pad)
    quality = measure_quality(
        mesh, pad, cad_volume_mm3=part.volume_mm3, cad_surface=tessellate_solid(part)
    )
    assert quality.min_dihedral_deg >= 10
    assert abs(quality.volume_error_percent or 0) <= 0.5
    assert (quality.hausdorff_mm or 0) <= 0.03
    assert quality.back_plane_error_mm < 1e-9
    assert quality.node_count <= 12_000


@given(st.floats(3.6, 6), st.floats(22, 28), st.floats(18, 24), st.floats(90, 300), st.floats(2, 4))
@settings(max_examples=3, deadline=None)
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


def test_digits_of_a_sweep_share_their_connectivity() -> None:
    pad = DigitPad(mid_radius_mm=30.0, thickness_mm=5.1, length_mm=27.0)
    mesh = gel_mesh(pad, counts_of=DIGIT)
    check_same(mesh, gel_mesh(DIGIT))
    check_sound(mesh, pad)


def check_same(mesh: TetMesh, other: TetMesh) -> None:
    for name in ("tets", "faces", "face_regions", "tet_layers"):
        assert getattr(mesh, name).tobytes() == getattr(other, name).tobytes()
    assert mesh.nodes_m.shape == other.nodes_m.shape


def test_bevels_wider_than_the_margin_do_not_fold() -> None:
    pad = GelPad(
        length_x_mm=17, length_y_mm=24.6, corner_radius_mm=0.3, thickness_mm=5.7, rim="chamfer",
        rim_mm=2.96, wall_mm=4.07, window_x_mm=13.4, window_y_mm=12.4,
    )  # fmt: skip
    check_sound(gel_mesh(pad, 1.5), pad)


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


def test_glued_walls_are_bond_faces() -> None:
    for mesh in (
        gel_mesh(BEVELLED, 2.5),
        focused_gel_mesh(BEVELLED, FocusOptions((5, -3), 3.0, 0.5, core=8, rings=12)),
    ):
        check_sound(mesh, BEVELLED)
        assert not (mesh.face_regions == int(Region.SIDE)).any()
        wall = mesh.nodes_m[mesh.bonded_nodes()] * 1e3
        assert wall[:, 2].max() == pytest.approx(-2.954, abs=0.1)


@pytest.mark.parametrize("name", ["gelsight_mini", "gelsight_40", "9dtact", "digit"])
def test_presses_anywhere_share_their_connectivity(name: str) -> None:
    pad = PADS[name]
    low, high = pad.outline.bounds_mm()
    rng = np.random.default_rng(7)
    reference = None
    for _ in range(4):
        at = rng.uniform(low, high)
        while pad.inside_distance_mm(at) < 3:
            at = rng.uniform(low, high)
        options = FocusOptions((at[0], at[1]), rng.uniform(1, 4), 0.15, core=12, rings=20)
        mesh = focused_gel_mesh(pad, options)
        check_sound(mesh, pad)
        reference = reference or mesh
        check_same(mesh, reference)


def test_counts_of_a_dome_are_refused() -> None:
    with pytest.raises(InputError, match="counts_of"):
        gel_mesh(MINI, counts_of=ShellDomePad())


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
