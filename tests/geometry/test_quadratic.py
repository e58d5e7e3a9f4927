# SPDX-License-Identifier: Apache-2.0
"""Ten-node meshes: numbering, faces, what is held, masses."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.quadratic import TET_EDGES, quadratic_mesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from tests.support.blocks import block_mesh

MESH = block_mesh((3, 2, 2), (3e-3, 2e-3, 2e-3), jitter=0.2)


def test_middle_nodes_lie_on_their_edges() -> None:
    made = quadratic_mesh(MESH)
    nodes = made.nodes_m
    for local, (i, j) in enumerate(TET_EDGES, start=4):
        ends = nodes[made.tets[:, [i, j]]]
        np.testing.assert_array_equal(nodes[made.tets[:, local]], ends.mean(axis=1))
    assert len(np.unique(made.tets)) == made.node_count
    np.testing.assert_array_equal(made.tets[:, :4], MESH.tets)


def test_faces_are_cut_in_four_and_keep_their_region() -> None:
    made = quadratic_mesh(MESH)

    def areas(nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
        p = nodes[faces]
        return np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) / 2

    coarse, fine = areas(MESH.nodes_m, MESH.faces), areas(made.nodes_m, made.faces)
    np.testing.assert_allclose(fine, np.repeat(coarse / 4, 4, axis=0), atol=1e-18)
    np.testing.assert_array_equal(made.face_regions, np.repeat(MESH.face_regions, 4))
    # Closed: every edge twice, in opposite directions.
    edges = made.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    codes = edges[:, 0] * made.node_count + edges[:, 1]
    reverse = edges[:, 1] * made.node_count + edges[:, 0]
    assert len(np.unique(codes)) == len(codes)
    np.testing.assert_array_equal(np.sort(codes), np.sort(reverse))


def test_middles_of_bond_faces_are_bonded() -> None:
    made = quadratic_mesh(MESH)
    low = MESH.nodes_m[:, 2].min()
    on_back = np.flatnonzero(made.nodes_m[:, 2] < low + 1e-12)
    np.testing.assert_array_equal(made.bonded_nodes(), on_back)
    np.testing.assert_array_equal(made.held_with(MESH.bonded_nodes()), on_back)


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
    np.testing.assert_array_equal(made.held_with(MESH.tets[0, :2]), np.sort(MESH.tets[0, :2]))


def test_masses_are_positive_and_conserved() -> None:
    made = quadratic_mesh(MESH)
    tet_masses = np.random.default_rng(0).uniform(1, 2, MESH.tet_count)
    masses = made.lumped_masses(tet_masses)
    assert masses.min() > 0
    assert masses.sum() == pytest.approx(tet_masses.sum(), rel=1e-13)
    # Its centre of mass: that of tets of uniform density.
    centers = MESH.nodes_m[MESH.tets].mean(axis=1)
    np.testing.assert_allclose(masses @ made.nodes_m, tet_masses @ centers, rtol=1e-12, atol=1e-15)


def test_linear_fields_are_interpolated() -> None:
    made = quadratic_mesh(MESH)
    field = np.random.default_rng(1).normal(size=(3, 2))
    values = made.with_middles((MESH.nodes_m @ field)[None])
    np.testing.assert_allclose(values[0], made.nodes_m @ field, atol=1e-17)


def test_faces_bound_the_tets() -> None:
    made = quadratic_mesh(MESH)
    corners = boundary_faces(made.tets[:, :4])
    of_faces = {tuple(sorted(f)) for f in MESH.faces.tolist()}
    assert {tuple(sorted(f)) for f in corners.tolist()} == of_faces
