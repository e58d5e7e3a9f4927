# SPDX-License-Identifier: Apache-2.0
"""Corners go to the paraboloid through the middles around them, and only those that hang."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry import QuadraticMesh, Region
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import AffineBody, Element, Material, Scene, SoftBody, TimeStepping, box_mesh
from taccel_lab.signals.hanging_corners import HangingCorners
from tests.support.blocks import pose

MESH = block_mesh((8, 8, 2), (4e-3, 4e-3, 1e-3), jitter=0.2, seed=1)


def bowl(nodes: np.ndarray) -> np.ndarray:
    """The face pressed by a paraboloid, 0.3 mm deep."""
    x, y = nodes[:, 0], nodes[:, 1]
    down = -3e-4 + 40.0 * x * x + 60.0 * y * y + 20.0 * x * y
    return nodes + np.column_stack([0 * x, 0 * x, down])


def lifted(
    moved_m: np.ndarray, carries: np.ndarray, element: Element, mounted: bool = False
) -> np.ndarray:
    """Nodes after ``lift``, of loads along -z on the nodes that carry."""
    soft = SoftBody(MESH, Material(1e5, 0.45), element=element)
    links = []
    if mounted:
        soft = replace(soft, mount="link", mount_pose=pose(0, 0, 1e-2, (1, 0, 0), 90))
        links = [AffineBody(box_mesh((2e-2, 2e-2, 2e-2)), name="link")]
    model = Scene(soft, affine_bodies=links, time=TimeStepping(quasi_static=not mounted)).finalize(
        device="cpu"
    )
    first, last = (int(node) for node in model.bodies[0].nodes)
    gradient, positions = np.zeros((2, 1, model.node_count, 3))
    gradient[0, first:last][carries, 2] = 1e-3
    positions[0, first:last] = moved_m
    moved = wp.array(positions, dtype=wp.vec3d)
    HangingCorners(model, 0).lift(moved, wp.array(gradient, dtype=wp.vec3d))
    return moved.numpy()[0, first:last]


def quadratic() -> QuadraticMesh:
    mesh = SoftBody(MESH, Material(1e5, 0.45)).nodal_mesh
    assert isinstance(mesh, QuadraticMesh)
    return mesh


@pytest.mark.parametrize("mounted", [False, True])
def test_only_a_corner_that_hangs_is_moved_and_to_the_paraboloid(mounted: bool) -> None:
    mesh = quadratic()
    right = bowl(mesh.nodes_m)
    face = mesh.region_nodes(Region.CONTACT)
    inner = np.abs(mesh.nodes_m[face, :2]).max(axis=1) < 1.6e-3
    hangs, stands = face[inner & (face < mesh.base.node_count)][[3, 10]]
    moved = right.copy()
    moved[hangs, 2] -= 4e-5
    moved[stands, 2] += 4e-5
    carries = np.isin(np.arange(mesh.node_count), face)
    found = lifted(moved, carries, Element.QUADRATIC, mounted)
    assert found[hangs] == pytest.approx(right[hangs], abs=1e-12)
    assert found[stands] == pytest.approx(moved[stands], abs=0)
    # The others hang by rounding at most.
    assert found == pytest.approx(
        np.where(np.arange(len(moved))[:, None] == hangs, right, moved), abs=1e-12
    )


def test_a_corner_at_the_rim_of_the_contact_stays() -> None:
    mesh = quadratic()
    moved = bowl(mesh.nodes_m)
    corners = mesh.region_nodes(Region.CONTACT)
    corner = corners[corners < mesh.base.node_count][20]
    moved[corner, 2] -= 4e-5
    right_side = mesh.nodes_m[:, 0] > mesh.nodes_m[corner, 0]
    assert (lifted(moved, right_side, Element.QUADRATIC)[corner] == moved[corner]).all()


def test_environments_with_gels_of_their_own_shape() -> None:
    """The same cells, graded otherwise in the second environment."""
    mesh = quadratic()
    graded = np.sign(MESH.nodes_m) * np.abs(MESH.nodes_m) ** [1.3, 1.2, 1.0]
    graded *= np.abs(MESH.nodes_m).max(axis=0) / np.abs(graded).max(axis=0)
    rests = np.stack([MESH.nodes_m, graded])
    soft = SoftBody(MESH, Material(1e5, 0.45), rest_positions_m=rests)
    model = Scene(soft_bodies=[soft], env_count=2).finalize(device="cpu")
    right = np.stack([bowl(rest) for rest in model.rest_positions.numpy()])
    face = mesh.region_nodes(Region.CONTACT)
    inner = np.abs(mesh.nodes_m[face, :2]).max(axis=1) < 1.6e-3
    hangs = face[inner & (face < mesh.base.node_count)][[3, 10]]
    moved = right.copy()
    moved[:, hangs, 2] -= 4e-5
    carries = np.isin(np.arange(mesh.node_count), face)
    gradient = np.broadcast_to(np.where(carries[:, None], [0.0, 0.0, 1e-3], 0.0), moved.shape)
    positions = wp.array(moved, dtype=wp.vec3d)
    HangingCorners(model, 0).lift(positions, wp.array(gradient.copy(), dtype=wp.vec3d))
    assert positions.numpy() == pytest.approx(right, abs=1e-12)


def test_linear_elements_have_none() -> None:
    moved = bowl(MESH.nodes_m)
    assert (lifted(moved, np.ones(len(moved), bool), Element.LINEAR) == moved).all()
