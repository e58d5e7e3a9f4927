# SPDX-License-Identifier: Apache-2.0
"""Quality measures on tets whose angles are known, the gate, and meshes made finer to pass it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.gel_mesh import SHORTER, gel_mesh, sound_gel_mesh, usual_edge_mm
from taccel_lab.cad.mesh.quality import (
    PRESS_GATE,
    QualityGate,
    check_quality,
    measure_quality,
    require_quality,
)
from taccel_lab.cad.mesh.quality_measures import EDGE_PAIRS, dihedral_angles_deg, mean_ratios
from taccel_lab.cad.mesh.surface import LabelledSurface, check_closed, weld
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.mesh.tet_smoothing import improve_worst_tets
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.sensors.registry import sensor_family

TET = np.array([[0, 1, 2, 3]])
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FLAT, CROWNED = GelPad(), GelPad(crown_radius_x_mm=80, crown_radius_y_mm=80)


def test_angles_and_mean_ratios_of_the_regular_tet_and_of_a_corner() -> None:
    regular = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])
    np.testing.assert_allclose(dihedral_angles_deg(regular, TET), np.rad2deg(np.arccos(1 / 3)))
    np.testing.assert_allclose(mean_ratios(regular, TET), 1)
    rotation, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    at_corner = (EDGE_PAIRS == 0).any(axis=1)
    for nodes in (CORNER, 1e-3 * CORNER @ rotation.T + 5):
        angles = dihedral_angles_deg(nodes, TET)[0]
        np.testing.assert_allclose(angles[at_corner], 90)
        np.testing.assert_allclose(angles[~at_corner], np.rad2deg(np.arccos(1 / np.sqrt(3))))
        # V = 1/6, squared edges 3 * 1 + 3 * 2.
        np.testing.assert_allclose(mean_ratios(nodes, TET), 12 * 0.5 ** (2 / 3) / 9)


@pytest.mark.thorough
def test_pad_measures_agree_with_the_pad() -> None:
    part, mesh = labelled_solid(CROWNED), gel_mesh(CROWNED, 1.5)
    fine = tessellate_solid(part)
    found = measure_quality(mesh, CROWNED, cad_volume_mm3=part.solid.volume, cad_surface=fine)
    assert found.back_plane_error_mm < 1e-12 and found.contact_error_mm < 1e-10
    assert found.region_areas_mm2["window"] == pytest.approx(18 * 14)
    assert found.volume_error_percent is not None and found.hausdorff_mm is not None
    assert -1 < found.volume_error_percent < 0
    # Chords of the corner arcs: two cells of 22.5 degrees on half an arc of radius 2.
    assert found.hausdorff_mm == pytest.approx(2 * (1 - np.cos(np.pi / 16)), abs=0.03)
    assert found.surface_rms_mm is not None and found.surface_rms_mm < found.hausdorff_mm
    require_quality(mesh, found)
    # The distance of two surfaces is the offset of two boxes.
    mesh = gel_mesh(FLAT, 2.0)
    cad = LabelledSurface(mesh.nodes_m * 1e3 + [0, 0, 0.25], mesh.faces, mesh.face_regions)
    found = measure_quality(mesh, None, cad_surface=cad)
    assert found.surface_rms_mm is not None and 0 < found.surface_rms_mm < 0.25
    # Of an imported part, glued and contact nodes count from the triangles of their regions.
    for error in (found.hausdorff_mm, found.back_plane_error_mm, found.contact_error_mm):
        assert error == pytest.approx(0.25, abs=1e-9)


def with_sliver(mesh: TetMesh) -> tuple[TetMesh, np.ndarray]:
    """One inner node pushed against a tet's opposite face, and where that is [mm]."""
    nodes = mesh.nodes_m.copy()
    inner = np.setdiff1d(np.arange(mesh.node_count), np.unique(mesh.faces))[0]
    tet = mesh.tets[(mesh.tets == inner).any(axis=1)][0]
    nodes[inner] += 0.999 * (nodes[tet[tet != inner]].mean(axis=0) - nodes[inner])
    return replace(mesh, nodes_m=nodes), nodes[tet].mean(axis=0) * 1e3


@pytest.mark.thorough
def test_gate_names_each_figure() -> None:
    mesh = gel_mesh(FLAT, 2.0)
    good = measure_quality(mesh, FLAT)
    assert require_quality(mesh, good).passed
    for change, limit in (
        ({"back_plane_error_mm": 0.01}, "max_bond_error_mm"),
        ({"volume_error_percent": -0.6}, "max_volume_error_percent"),
        ({"volume_error_percent": 0.6}, "max_volume_error_percent"),
        ({"hausdorff_mm": 0.031}, "max_hausdorff_mm"),
        ({"interface_error_mm": 0.031}, "max_interface_error_mm"),
        ({"misplaced_percent": 0.6}, "max_misplaced_percent"),
        ({"region_areas_mm2": {**good.region_areas_mm2, "window": 0.0}}, "regions"),
    ):
        spoiled = replace(good, **change)  # type: ignore[arg-type]
        (violation,) = check_quality(mesh, spoiled).violations
        assert violation.limit == limit
        with pytest.raises(InputError, match="unfit to be simulated"):
            require_quality(mesh, spoiled)
    # The last of them.
    assert violation.text == "the mesh has no WINDOW faces"


@pytest.mark.thorough
@pytest.mark.rasterised
def test_planted_faults_are_all_found_and_drawn(tmp_path: Path) -> None:
    part, mesh = labelled_solid(CROWNED), gel_mesh(CROWNED, 1.5)
    bad, at = with_sliver(mesh)
    nodes = bad.nodes_m.copy()
    glued, touched = mesh.bonded_nodes(), mesh.region_nodes(Region.CONTACT)
    loose = glued[int(np.linalg.norm(nodes[glued] - [5e-3, 5e-3, -4e-3], axis=1).argmin())]
    nodes[loose, 2] -= 2e-5
    dent = touched[int(np.linalg.norm(nodes[touched, :2] - [-5e-3, 5e-3], axis=1).argmin())]
    nodes[dent, 2] -= 1e-4
    bad = replace(bad, nodes_m=nodes)
    # A tet inside out cannot be made through the constructor, which checks; a file could hold one.
    turned = bad.tets.copy()
    far = int(np.linalg.norm(nodes[bad.tets].mean(axis=1) - [8e-3, 0, -2e-3], axis=1).argmin())
    turned[far] = turned[far][[0, 2, 1, 3]]
    object.__setattr__(bad, "tets", turned)
    volume, surface = 1.02 * part.solid.volume, tessellate_solid(part)
    found = measure_quality(bad, CROWNED, cad_volume_mm3=volume, cad_surface=surface)
    result = check_quality(bad, found)
    places = {v.limit: np.array(v.at_mm) for v in result.violations}
    assert set(places) == {
        "positive volumes", "min_dihedral_deg", "max_bond_error_mm", "max_volume_error_percent",
        "max_hausdorff_mm",
    }  # fmt: skip
    np.testing.assert_allclose(places["min_dihedral_deg"], at, atol=1.5)
    np.testing.assert_allclose(places["max_bond_error_mm"], nodes[loose] * 1e3, atol=1e-9)
    np.testing.assert_allclose(places["max_hausdorff_mm"], nodes[dent] * 1e3, atol=0.8)
    np.testing.assert_allclose(places["positive volumes"], [8, 0, -2], atol=1.5)
    assert result.bad[far] and 2 <= result.bad.sum() < 20
    json.dumps(result.to_json(), allow_nan=False)
    words = r"(?s)dihedral angle under 10 deg.* x .*bad_mesh\.png shows where"
    with pytest.raises(InputError, match=words) as error:
        require_quality(bad, found, picture_folder=tmp_path)
    assert all(v.text in str(error.value) for v in result.violations)
    x = float(str(error.value).split(" x ")[1].split(",")[0])
    assert x == pytest.approx(8, abs=1.5)
    picture = matplotlib.image.imread(tmp_path / "bad_mesh.png")
    red = (picture[..., 0] > 0.7) & (picture[..., 1] < 0.3) & (picture[..., 2] < 0.3)
    left, right = np.split(red[:, : red.shape[1] // 2 * 2], 2, axis=1)
    assert left.sum() > 20 and right.sum() > 300


def test_coarse_meshes_may_have_longer_chords_and_no_worse_angles() -> None:
    gate = QualityGate().at_edge(2.0)
    assert gate.max_hausdorff_mm == pytest.approx(0.12)
    assert gate.max_volume_error_percent == pytest.approx(2.0)
    assert gate.min_dihedral_deg == 10 and gate.max_bond_error_mm == 1e-6
    assert QualityGate().at_edge(0.5) == QualityGate() and gate.at_edge(1.0) == gate
    with pytest.raises(InputError, match="edge_mm"):
        QualityGate().at_edge(0.0)
    mesh = gel_mesh(FLAT, 2.0)
    good = replace(measure_quality(mesh, FLAT), hausdorff_mm=0.1)
    passed = check_quality(mesh, good, gate)
    assert passed.passed and passed.to_json()["relaxed_for_edge"]
    assert not check_quality(mesh, good).passed
    assert check_quality(mesh, replace(good, hausdorff_mm=2.0), PRESS_GATE).passed
    assert PRESS_GATE.min_dihedral_deg == 2.0


class Halves(GelPad):
    """Two layers that meet at a height that is set later."""

    level_mm = -1.0

    @property
    def layer_names(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("gel", "skin")

    def layer_of(self, points_mm: np.ndarray) -> np.ndarray:
        return (points_mm[:, 2] > self.level_mm).astype(np.int32)


@pytest.mark.thorough
def test_layers_that_do_not_conform_are_found() -> None:
    pad = Halves(thickness_mm=2)
    mesh = gel_mesh(GelPad(thickness_mm=2), 1.0)
    level = (np.unique(mesh.nodes_m[:, 2].round(9)) * 1e3)[1]
    object.__setattr__(pad, "level_mm", level)
    volume = mesh.volumes_m3().sum() * 1e9
    below = volume * (level + 2) / 2
    fitting = replace(mesh, tet_layers=pad.layer_of(mesh.nodes_m[mesh.tets].mean(axis=1) * 1e3))
    found = measure_quality(fitting, pad)
    assert found.interface_error_mm == pytest.approx(0, abs=1e-6)
    assert found.misplaced_percent == 0
    assert found.layer_volumes_mm3 == pytest.approx((below, volume - below))
    assert check_quality(fitting, found).passed
    off = measure_quality(replace(fitting, nodes_m=mesh.nodes_m * [1, 1, 0.9]), pad)
    assert off.interface_error_mm == pytest.approx(-0.1 * level, rel=0.15)
    all_gel = measure_quality(mesh, pad)
    assert all_gel.misplaced_percent == pytest.approx(100 * (1 - below / volume))
    assert "max_misplaced_percent" in [v.limit for v in check_quality(mesh, all_gel).violations]


def test_open_surfaces_are_refused_and_welding_closes_them() -> None:
    corners = CORNER[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(-1, 3)
    loose = np.arange(12).reshape(4, 3)
    with pytest.raises(InputError, match="12 open"):
        check_closed(loose, "it")
    vertices, triangles = weld(corners, loose, 1e-6)
    assert len(vertices) == 4
    check_closed(triangles, "it")


@pytest.mark.slow
def test_a_digit_cast_flat_gets_a_sound_mesh() -> None:
    """The usual mesh has tets of 8.4 degrees at its fillet."""
    pad = sensor_family("digit").parameters({"mid_radius_mm": 0, "roll_off": 0}).pad()
    mesh, quality, edge_mm = sound_gel_mesh(pad)
    assert check_quality(mesh, quality, QualityGate().at_edge(edge_mm)).passed
    assert edge_mm in [pytest.approx(share * usual_edge_mm(pad)) for share in SHORTER[1:]]


@given(st.integers(0, 1000))
@settings(max_examples=10)
def test_worst_tets_get_rounder_and_only_free_nodes_move(seed: int) -> None:
    cube = block_mesh((4, 4, 4), (4.0, 4.0, 4.0))
    inner = np.setdiff1d(cube.tets, cube.faces)
    nodes = cube.nodes_m.copy()
    nodes[inner] += np.random.default_rng(seed).uniform(-0.33, 0.33, (len(inner), 3))

    def least_volume(nodes: np.ndarray) -> float:
        p = nodes[cube.tets]
        return np.linalg.det(p[:, 1:] - p[:, :1]).min()

    if least_volume(nodes) <= 1e-3:
        return
    before = dihedral_angles_deg(nodes, cube.tets).min()
    moved = improve_worst_tets(nodes, cube.tets, inner, wanted_deg=30)
    assert dihedral_angles_deg(moved, cube.tets).min() > before + 1 or before >= 30
    fixed = np.setdiff1d(cube.tets, inner)
    assert np.array_equal(moved[fixed], nodes[fixed])
    assert least_volume(moved) > 0
