# SPDX-License-Identifier: Apache-2.0
"""Quality measures on tets whose angles are known, and the gate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cad.mesh.closest import ClosestPoint
from cad.mesh.quality import measure_quality, require_quality, surface_distance_mm
from cad.mesh.quality_measures import EDGE_PAIRS, dihedral_angles_deg, mean_ratios
from cad.mesh.even import even_gel_mesh
from cad.mesh.surface import LabelledSurface, check_closed, weld
from cad.mesh.tessellate import tessellate_solid
from cad.parts.gel_pad import GelPad
from cad.parts.gel_pad_solid import gel_pad_solid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh

TET = np.array([[0, 1, 2, 3]])
REGULAR = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def test_regular_tet() -> None:
    np.testing.assert_allclose(dihedral_angles_deg(REGULAR, TET), np.rad2deg(np.arccos(1 / 3)))
    assert dihedral_angles_deg(REGULAR, TET)[0, 0] == pytest.approx(70.5288, abs=1e-4)
    np.testing.assert_allclose(mean_ratios(REGULAR, TET), 1)


def test_corner_tet_has_right_angles_at_its_corner() -> None:
    angles = dihedral_angles_deg(CORNER, TET)[0]
    at_corner = (EDGE_PAIRS == 0).any(axis=1)
    np.testing.assert_allclose(angles[at_corner], 90)
    np.testing.assert_allclose(angles[~at_corner], np.rad2deg(np.arccos(1 / np.sqrt(3))))
    # V = 1/6, squared edges 3 * 1 + 3 * 2.
    np.testing.assert_allclose(mean_ratios(CORNER, TET), 12 * 0.5 ** (2 / 3) / 9)


def test_measures_ignore_size_position_and_rotation() -> None:
    rotation, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    moved = 1e-3 * CORNER @ rotation.T + 5
    angles = dihedral_angles_deg(moved, TET), dihedral_angles_deg(CORNER, TET)
    np.testing.assert_allclose(*angles, rtol=1e-8)
    np.testing.assert_allclose(mean_ratios(moved, TET), mean_ratios(CORNER, TET), rtol=1e-8)


def test_flat_and_inverted_tets_show() -> None:
    flat = CORNER * [1, 1, 1e-6]
    assert dihedral_angles_deg(flat, TET).min() < 1e-3
    assert mean_ratios(flat, TET)[0] < 1e-3
    assert mean_ratios(CORNER, TET[:, [0, 2, 1, 3]])[0] < 0


def test_pad_measures_agree_with_the_pad() -> None:
    pad = GelPad(crown_radius_x_mm=80, crown_radius_y_mm=80)
    part, mesh = gel_pad_solid(pad), even_gel_mesh(pad, 1.5)
    fine = tessellate_solid(part)
    found = measure_quality(mesh, pad, cad_volume_mm3=part.solid.volume, cad_surface=fine)
    assert found.back_plane_error_mm < 1e-12 and found.contact_error_mm < 1e-10
    assert found.region_areas_mm2["window"] == pytest.approx(18 * 14)
    assert found.volume_error_percent is not None and -1 < found.volume_error_percent < 0
    # Chords of the corner arcs: two cells of 22.5 degrees on half an arc of radius 2.
    assert found.hausdorff_mm == pytest.approx(2 * (1 - np.cos(np.pi / 16)), abs=0.03)
    assert found.surface_rms_mm is not None and found.surface_rms_mm < found.hausdorff_mm
    require_quality(mesh, found)


def test_surface_distance_is_the_offset_of_two_boxes() -> None:
    pad = GelPad()
    faces = even_gel_mesh(pad, 2.0).faces
    nodes = even_gel_mesh(pad, 2.0).nodes_m * 1e3
    regions = np.zeros(len(faces), dtype=np.int32)
    low = LabelledSurface(nodes, faces, regions)
    high = LabelledSurface(nodes + [0, 0, 0.25], faces, regions)
    hausdorff, rms = surface_distance_mm(low, high)
    assert hausdorff == pytest.approx(0.25, abs=1e-9)
    assert 0 < rms < 0.25


def test_closest_point_finds_distance_and_triangle() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    triangles = np.array([[0, 1, 2], [1, 3, 2]])
    distance, cell = ClosestPoint(vertices, triangles)(np.array([[0.1, 0.1, 2.0], [2.0, 1, 0]]))
    np.testing.assert_allclose(distance, [2, 1], atol=1e-12)
    assert cell.tolist() == [0, 1]


def test_gate_names_place_and_figure() -> None:
    pad = GelPad()
    mesh = even_gel_mesh(pad, 2.0)
    nodes = mesh.nodes_m.copy()
    # Push one inner node against a tet's opposite face: a sliver at a known place.
    inner = np.setdiff1d(np.arange(mesh.node_count), np.unique(mesh.faces))[0]
    tet = mesh.tets[(mesh.tets == inner).any(axis=1)][0]
    nodes[inner] += 0.999 * (nodes[tet[tet != inner]].mean(axis=0) - nodes[inner])
    bad = TetMesh(nodes, mesh.tets, mesh.faces, mesh.face_regions)
    quality = measure_quality(bad, pad)
    with pytest.raises(InputError, match=r"dihedral angle under 2 deg.* x ") as error:
        require_quality(bad, quality)
    x = float(str(error.value).split(" x ")[1].split(",")[0])
    assert x == pytest.approx(nodes[tet].mean(axis=0)[0] * 1e3, abs=1.5)
    good = measure_quality(mesh, pad)
    with pytest.raises(InputError, match="off the back plane"):
        require_quality(mesh, replace(good, back_plane_error_mm=0.01))
    with pytest.raises(InputError, match="volume"):
        require_quality(mesh, replace(good, volume_error_percent=-9.0))
    areas = {**good.region_areas_mm2, Region.WINDOW.name.lower(): 0.0}
    with pytest.raises(InputError, match="WINDOW"):
        require_quality(mesh, replace(good, region_areas_mm2=areas))


def test_open_surfaces_are_refused_and_welding_closes_them() -> None:
    corners = CORNER[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(-1, 3)
    loose = np.arange(12).reshape(4, 3)
    with pytest.raises(InputError, match="12 open"):
        check_closed(loose, "it")
    vertices, triangles = weld(corners, loose, 1e-6)
    assert len(vertices) == 4
    check_closed(triangles, "it")
