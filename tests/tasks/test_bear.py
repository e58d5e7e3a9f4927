# SPDX-License-Identifier: Apache-2.0
"""The bear that is kept is the union of the balls that it was made of, meshed by fTetWild."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.bodies.mesh_checks import check_tets
from taccel_lab.geometry.tet_mesh import tet_volumes
from taccel_lab.tasks.catalogue import named
from taccel_lab.tasks.grasp_lift import SoftGraspParameters, SoftShape

BEAR = (
    (0.0, 0.0, 14.0, 13.0),  # Belly.
    (0.0, -1.0, 32.0, 10.0),  # Head.
    (0.0, -10.0, 30.0, 4.5),  # Snout.
    (8.0, 1.0, 39.5, 4.0), (-8.0, 1.0, 39.5, 4.0),  # Ears.
    (12.0, -5.0, 19.0, 4.5), (-12.0, -5.0, 19.0, 4.5),  # Arms.
    (8.5, -9.0, 5.5, 5.5), (-8.5, -9.0, 5.5, 5.5),  # Legs.
    (0.0, 11.0, 5.0, 5.0),  # Tail, on which it sits.
)  # fmt: skip
"""Middle and radius of each ball [mm]; it sits on z = 0 and looks along -y."""


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
