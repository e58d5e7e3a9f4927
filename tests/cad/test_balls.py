# SPDX-License-Identifier: Apache-2.0
"""Unions of balls in tets, and the bear that is kept."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.bodies.mesh_checks import check_tets
from taccel_lab.cad.mesh.balls import BEAR, balls_mesh
from taccel_lab.geometry import Region
from taccel_lab.geometry.tet_mesh import tet_volumes
from taccel_lab.tasks.catalogue import named
from taccel_lab.tasks.grasp_lift import SoftGraspParameters, SoftShape


def test_two_balls_that_touch_in_a_lens() -> None:
    balls = np.array([(0.0, 0.0, 0.0, 10.0), (12.0, 0.0, 0.0, 8.0)])
    # Less the lens, of caps of 10 - 7.5 and 8 - 4.5 mm height.
    caps = [np.pi * h**2 * (3 * r - h) / 3 for r, h in ((10.0, 2.5), (8.0, 3.5))]
    volume = 4 / 3 * np.pi * (10.0**3 + 8.0**3) - sum(caps)
    missing = []
    for edge_mm in (3.0, 1.5):
        mesh = balls_mesh(balls, edge_mm)
        check_tets(mesh, "balls")
        assert (mesh.face_regions == int(Region.SIDE)).all()
        missing.append(1 - 1e9 * tet_volumes(mesh.nodes_m, mesh.tets).sum() / volume)
    # Chords cut off some of it, a quarter as much where they are half as long.
    assert 0 < missing[1] < 0.02 and missing[0] == pytest.approx(4 * missing[1], rel=0.4)


def test_the_bear_is_the_union_of_its_balls() -> None:
    parameters = named("soft-bear").parameters
    assert isinstance(parameters, SoftGraspParameters)
    assert isinstance(parameters.object, SoftShape)
    mesh = parameters.object.shape()
    check_tets(mesh, "bear")
    np.testing.assert_allclose(mesh.nodes_m.mean(axis=0), 0, atol=1e-12)
    balls = np.array(BEAR)
    points = np.random.default_rng(0).uniform([-20, -20, -2], [20, 20, 46], (200_000, 3))
    away = np.linalg.norm(points[:, None] - balls[:, :3], axis=2) - balls[:, 3]
    volume = 40 * 40 * 48 * (away.min(axis=1) < 0).mean()
    assert 1e9 * tet_volumes(mesh.nodes_m, mesh.tets).sum() == pytest.approx(volume, rel=0.1)
    assert parameters.object.half_height_m == pytest.approx(19e-3, abs=2e-3)
