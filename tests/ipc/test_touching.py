# SPDX-License-Identifier: Apache-2.0
"""What brought two bodies together is no sliding."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.presses import parse_indenter
from taccel_lab.scene import KinematicBody, TriangleMesh, box_mesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, everywhere, pose, scene
from tests.verification.assembly import Assembly

DHAT, EPS, MU = 1e-5, 1e-6, 0.7
FROM, TO = 60e-6, 5e-6
"""Gaps above the gel where the step begins, and where it is now [m]."""
MESH = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
BLADE = parse_indenter("edge:90x4").shape
assert isinstance(BLADE, TriangleMesh)
PLATE = box_mesh((6e-3, 6e-3, 1e-3))


def friction_over_normal(shape: TriangleMesh, aside: float) -> np.ndarray:
    """Friction on the gel over mu times the normal force, after a body has come straight down and
    ``aside`` [m] along x."""
    low = float(shape.vertices_m[:, 2].min())
    start = everywhere(1, pose(0, 0, FROM - low))
    end = everywhere(1, pose(aside, 0, TO - low))
    model = scene(MESH, KinematicBody(shape, MU), env_count=1).finalize()
    assembly = Assembly(model, SolverConfig(dhat_m=DHAT, friction_eps_m=EPS), end)
    before = initial_state(model, start).positions.numpy()
    now = initial_state(model, end).positions.numpy()
    assert assembly.collide(now) > 0
    friction = assembly.solver.friction
    assert friction is not None
    friction.begin_step(
        wp.full(1, 1, dtype=wp.int32), wp.full(1, model.scene.time.dt_s, dtype=wp.float64)
    )
    x, then = assembly.nodal(now), assembly.nodal(before)
    friction.lag(assembly.active, x, then)
    poses = [wp.array(p, dtype=wp.transformd) for p in (end, start)]
    gradient = assembly.nodal()
    motion = friction.motion(x, then, poses[0], poses[1])
    friction.add_gradient(assembly.active, motion, gradient)
    gel = slice(0, MESH.node_count)
    normal = np.linalg.norm(assembly.contact_gradient(now)[0, gel], axis=1).sum()
    return -gradient.numpy()[0, gel].sum(axis=0) / (MU * normal)


@pytest.mark.parametrize("aside", [0.3e-6, -0.3e-6])
def test_a_blade_that_comes_straight_down_has_slid_by_what_it_went_aside(aside: float) -> None:
    """It stands 0.3 um beside a row of nodes, 5 um away: against the tilted normals the 55 um of
    its way down would be sliding of 3 um, far beyond static friction."""
    found = friction_over_normal(BLADE, aside)
    y = abs(aside) / EPS
    assert found[0] == pytest.approx(np.sign(aside) * y * (2 - y), rel=0.1)


def test_between_flat_faces_all_that_went_aside_is_sliding() -> None:
    y = 0.3
    found = friction_over_normal(PLATE, y * EPS)
    assert found == pytest.approx([y * (2 - y), 0, 0], abs=1e-3)
