# SPDX-License-Identifier: Apache-2.0
"""What part of a surface each node stands for."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.bodies.surface_topology import surface_areas, surface_topology
from taccel_lab.geometry.quadratic import quadratic_mesh
from taccel_lab.model.elastic import discretize
from taccel_lab.scene import Material, SoftBody, box_mesh, sphere_mesh
from tests.support.blocks import block_mesh


def node_areas(
    nodes: np.ndarray,
    faces: np.ndarray,
    shares: np.ndarray | None = None,
    preferred: np.ndarray | None = None,
) -> np.ndarray:
    topology = surface_topology(faces, len(nodes), "test")
    return surface_areas(nodes[None], topology, shares, preferred)[0][0]


def test_within_a_plane_it_is_a_third_of_each_face() -> None:
    mesh = block_mesh((4, 3, 1), (3e-3, 2e-3, 1e-3), jitter=0.3)
    top = mesh.faces[np.isclose(mesh.nodes_m[mesh.faces][..., 2], 0).all(axis=1)]
    area = node_areas(mesh.nodes_m, top)
    p = mesh.nodes_m[top]
    third = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 6
    expected = np.bincount(top.ravel(), np.repeat(third, 3), minlength=len(area))
    np.testing.assert_allclose(area, expected, rtol=1e-12)
    assert area.sum() == pytest.approx(6e-6)


def test_at_a_rim_it_is_one_side_and_not_the_sum() -> None:
    """The corners of a box stand for a quarter of a side, give or take how its faces are cut."""
    box = box_mesh((1.0, 1.0, 1.0))
    area = node_areas(box.vertices_m, box.faces)
    assert area.mean() == pytest.approx(0.25, rel=0.1)
    assert area.min() > 0.16 and area.max() < 0.34


def test_preferred_faces_decide_alone() -> None:
    mesh = block_mesh((4, 4, 1), (1e-3, 1e-3, 3e-3))
    is_top = np.isclose(mesh.nodes_m[mesh.faces][..., 2], 0).all(axis=1)
    area = node_areas(mesh.nodes_m, mesh.faces, preferred=is_top)
    top = np.unique(mesh.faces[is_top])
    assert area[top].sum() == pytest.approx(1e-6)
    without = node_areas(mesh.nodes_m, mesh.faces)
    assert without[top].sum() > 1.5e-6
    beside = np.setdiff1d(np.arange(len(area)), top)
    np.testing.assert_array_equal(area[beside], without[beside])


def test_a_smooth_surface_keeps_nearly_all_of_it() -> None:
    ball = sphere_mesh(1e-3, 2e-4)
    area = node_areas(ball.vertices_m, ball.faces)
    assert area.sum() == pytest.approx(4e-6 * np.pi, rel=0.03)


def test_shares_move_area_to_the_middles_of_quadratic_faces() -> None:
    mesh = block_mesh((3, 3, 1), (1e-3, 1e-3, 1e-3))
    part = discretize(SoftBody(mesh, Material(1e5, 0.4)))
    np.testing.assert_allclose(part.face_shares.sum(axis=1), 1)
    nodes = quadratic_mesh(mesh).nodes_m
    area = node_areas(nodes, part.faces, part.face_shares, part.contact_faces)
    on_top = np.isclose(nodes[:, 2], 0)
    corners = on_top & (np.arange(len(nodes)) < mesh.node_count)
    assert area[on_top].sum() == pytest.approx(1e-6)
    assert 0 < area[corners].sum() == pytest.approx(0.05 * 0.25 * 1e-6)
