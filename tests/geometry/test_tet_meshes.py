# SPDX-License-Identifier: Apache-2.0
"""Tet meshes: bisection, ten nodes a tet, VTU files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.bisection import bisected
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.quadratic import TET_EDGES, quadratic_mesh
from taccel_lab.geometry.vtu import write_mesh_vtu
from tests.geometry.vtu_files import read_mesh_vtu


def shaken(seed: int) -> TetMesh:
    """A block whose inner nodes are somewhere else, in two layers."""
    mesh = block_mesh((4, 3, 3), (4e-3, 3e-3, 3e-3))
    inner = np.setdiff1d(np.arange(mesh.node_count), np.unique(mesh.faces))
    nodes = mesh.nodes_m.copy()
    nodes[inner] += np.random.default_rng(seed).uniform(-1e-4, 1e-4, (len(inner), 3))
    layers = (nodes[mesh.tets].mean(axis=1)[:, 2] > -1e-3).astype(np.int32)
    return TetMesh(nodes, mesh.tets, mesh.faces, mesh.face_regions, layers)


def vector_areas(corners: np.ndarray) -> np.ndarray:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def area_m2(mesh: TetMesh, region: Region) -> float:
    areas = vector_areas(mesh.nodes_m[mesh.region_faces(region)])
    return float(np.linalg.norm(areas, axis=1).sum())


@pytest.mark.thorough
@settings(max_examples=15)
@given(
    seed=st.integers(0, 9),
    place=st.tuples(*[st.floats(-2e-3, 2e-3)] * 2),
    size=st.floats(1.5e-4, 5e-4),
)
def test_a_finer_mesh_is_the_same_body(seed: int, place: tuple[float, float], size: float) -> None:
    mesh = shaken(seed)

    def sizes(points: np.ndarray) -> np.ndarray:
        return size + 0.6 * np.linalg.norm(points - (*place, 0.0), axis=1)

    fine = bisected(mesh, sizes)
    # Every face lies between two tets or on the surface: no hanging nodes.
    corners = np.sort(fine.tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]], axis=-1)
    faces, uses = np.unique(corners.reshape(-1, 3), axis=0, return_counts=True)
    assert uses.max() == 2
    surface = np.sort(fine.faces, axis=1)
    assert {tuple(f) for f in faces[uses == 1]} == {tuple(f) for f in surface}
    assert np.isclose(fine.volumes_m3().sum(), mesh.volumes_m3().sum(), rtol=1e-12)
    for region in Region:
        assert np.isclose(area_m2(fine, region), area_m2(mesh, region), rtol=1e-12)
    for layer in (0, 1):
        before, after = (m.volumes_m3()[m.tet_layers == layer].sum() for m in (mesh, fine))
        assert np.isclose(after, before, rtol=1e-12)
    ends = fine.nodes_m[fine.tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]]]
    longest = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=-1).max(axis=1)
    assert (longest <= sizes(fine.nodes_m[fine.tets].mean(axis=1))).all()
    # Rivara: not below half of the smallest angle; in practice a third of what was there.
    least = [dihedral_angles_deg(m.nodes_m, m.tets).min() for m in (mesh, fine)]
    assert least[1] > 0.3 * least[0]


def test_what_is_fine_enough_stays_and_millions_are_refused() -> None:
    mesh = shaken(1)
    same = bisected(mesh, lambda points: np.full(len(points), 1.0))
    assert np.array_equal(same.nodes_m, mesh.nodes_m) and np.array_equal(same.tets, mesh.tets)
    with pytest.raises(InputError, match="more than 1,000 tets"):
        bisected(mesh, lambda points: np.full(len(points), 1e-5), most_tets=1000)


BLOCK = block_mesh((4, 3, 2), (4e-3, 3e-3, 2e-3), jitter=0.2)
MADE = quadratic_mesh(BLOCK)


def test_middle_nodes_lie_on_their_edges() -> None:
    for local, (i, j) in enumerate(TET_EDGES, start=4):
        ends, middles = MADE.nodes_m[MADE.tets[:, [i, j]]], MADE.nodes_m[MADE.tets[:, local]]
        np.testing.assert_array_equal(middles, ends.mean(axis=1))
    assert len(np.unique(MADE.tets)) == MADE.node_count
    np.testing.assert_array_equal(MADE.tets[:, :4], BLOCK.tets)


def test_faces_are_cut_in_four_and_keep_their_region() -> None:
    coarse, fine = (vector_areas(m.nodes_m[m.faces]) for m in (BLOCK, MADE))
    np.testing.assert_allclose(fine, np.repeat(coarse / 4, 4, axis=0), atol=1e-18)
    np.testing.assert_array_equal(MADE.face_regions, np.repeat(BLOCK.face_regions, 4))
    # Closed: every edge twice, in opposite directions.
    edges = MADE.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    codes = edges[:, 0] * MADE.node_count + edges[:, 1]
    reverse = edges[:, 1] * MADE.node_count + edges[:, 0]
    assert len(np.unique(codes)) == len(codes)
    np.testing.assert_array_equal(np.sort(codes), np.sort(reverse))


def test_middles_of_bond_faces_are_bonded() -> None:
    low = BLOCK.nodes_m[:, 2].min()
    on_back = np.flatnonzero(MADE.nodes_m[:, 2] < low + 1e-12)
    np.testing.assert_array_equal(MADE.bonded_nodes(), on_back)
    np.testing.assert_array_equal(MADE.held_with(BLOCK.bonded_nodes()), on_back)


def test_an_edge_between_two_bonded_faces_stays_free() -> None:
    """A single layer held on both sides: it may still bulge in the middle."""
    mesh = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
    regions = mesh.face_regions.copy()
    regions[regions == Region.CONTACT] = Region.BOND
    made = quadratic_mesh(TetMesh(mesh.nodes_m, mesh.tets, mesh.faces, regions))
    middle = np.isclose(made.nodes_m[:, 2], -0.5e-3)
    assert middle.sum() > 9
    assert not middle[made.bonded_nodes()].any()
    # A user who lists all corners holds the whole tets between them.
    assert len(made.held_with(np.arange(mesh.node_count))) == made.node_count
    # Two corners alone do not hold what is between them.
    np.testing.assert_array_equal(made.held_with(BLOCK.tets[0, :2]), np.sort(BLOCK.tets[0, :2]))


def test_masses_are_positive_and_conserved() -> None:
    tet_masses = np.random.default_rng(0).uniform(1, 2, BLOCK.tet_count)
    masses = MADE.lumped_masses(tet_masses)
    assert masses.min() > 0
    assert masses.sum() == pytest.approx(tet_masses.sum(), rel=1e-13)
    # Its centre of mass: that of tets of uniform density.
    centers = BLOCK.nodes_m[BLOCK.tets].mean(axis=1)
    np.testing.assert_allclose(masses @ MADE.nodes_m, tet_masses @ centers, rtol=1e-12, atol=1e-15)


def test_linear_fields_are_interpolated() -> None:
    field = np.random.default_rng(1).normal(size=(3, 2))
    values = MADE.with_middles((BLOCK.nodes_m @ field)[None])
    np.testing.assert_allclose(values[0], MADE.nodes_m @ field, atol=1e-17)


def test_mesh_comes_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "pad.vtu"
    write_mesh_vtu(path, BLOCK)
    again = read_mesh_vtu(path)
    for name in ("nodes_m", "tets", "faces", "face_regions"):
        assert np.array_equal(getattr(again, name), getattr(BLOCK, name))
    assert again.nodes_m.dtype == np.float64
    assert pyvista.read(path).volume == pytest.approx(BLOCK.volumes_m3().sum(), rel=1e-9)
    write_mesh_vtu(path, MADE)
    back = pyvista.read(path)
    assert np.array_equal(back.points, MADE.nodes_m)
    assert np.array_equal(back.cells_dict[5], MADE.faces)
    assert np.array_equal(back.cells_dict[10], BLOCK.tets)


def test_deformed_positions_and_fields(tmp_path: Path) -> None:
    path = tmp_path / "pressed.vtu"
    rng = np.random.default_rng(0)
    positions = BLOCK.nodes_m + 1e-5 * rng.normal(size=BLOCK.nodes_m.shape)
    force = rng.normal(size=(BLOCK.node_count, 3)).astype(np.float32)
    pressure = rng.normal(size=BLOCK.node_count)
    pressure[0] = np.nan
    fields = {"force_n": force, "pressure_pa": pressure}
    write_mesh_vtu(path, BLOCK, positions_m=positions, point_data=fields)
    grid = pyvista.read(path)
    assert np.array_equal(grid.points, positions)
    for name, values in fields.items():
        assert np.array_equal(grid.point_data[name], values, equal_nan=True)
    assert (grid.cell_data["region"][: BLOCK.tet_count] == -1).all()


def test_arrays_of_other_length_are_refused_and_nothing_is_left(tmp_path: Path) -> None:
    for wrong, words in (
        ({"point_data": {"f": np.zeros(3)}}, "'f'"),
        ({"positions_m": np.zeros((2, 3))}, "positions"),
    ):
        with pytest.raises(InputError, match=words):
            write_mesh_vtu(tmp_path / "pad.vtu", BLOCK, **wrong)
    assert list(tmp_path.iterdir()) == []
