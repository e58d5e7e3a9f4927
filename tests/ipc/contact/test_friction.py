# SPDX-License-Identifier: Apache-2.0
"""Lagged friction and tangent frames: what brought two bodies together is no sliding."""

from __future__ import annotations

import ipctk
import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.potentials.friction import step_motion
from taccel_lab.presses import parse_indenter
from taccel_lab.scene import KinematicBody, TriangleMesh, box_mesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import initial_state
from tests.ipc import batch
from tests.ipc.batch import Array
from tests.support.blocks import block_mesh, everywhere, pose, scene
from tests.verification.assembly import Assembly

EPS_U = 1e-3
MU_LAMBDA = 0.7


def contacts(seed: int, count: int) -> tuple[Array, Array, Array]:
    """Weights, normals and displacements; |u| spreads over 1e-3 .. 1e3 of eps_u."""
    rng = np.random.default_rng(seed)
    bary = rng.dirichlet(np.ones(3), size=count)
    weights = np.concatenate([np.ones((count, 1)), -bary], axis=1)
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    dx = rng.normal(size=(count, 4, 3)) * EPS_U * 10.0 ** rng.uniform(-3, 3, (count, 1, 1))
    return weights, n, dx


def test_smoothing_equals_ipctk() -> None:
    weights, n, dx = contacts(0, 1000)
    smoothing, u, *_ = batch.friction_terms(weights, n, dx, MU_LAMBDA, EPS_U)
    size = np.linalg.norm(u, axis=1)
    assert 100 < np.sum(size < EPS_U) < 900
    functions = (
        ipctk.smooth_friction_f0,
        ipctk.smooth_friction_f1_over_x,
        ipctk.smooth_friction_f2,
    )
    for column, function in enumerate(functions):
        expected = [function(value, EPS_U) for value in size]
        np.testing.assert_allclose(smoothing[:, column], expected, rtol=1e-12, atol=1e-15)


def test_hessian_is_semidefinite_also_at_rest() -> None:
    weights, n, dx = contacts(4, 500)
    dx[:100] = 0.0
    _, _, value, gradient, hessian = batch.friction_terms(weights, n, dx, MU_LAMBDA, EPS_U)
    lowest = np.linalg.eigvalsh(hessian)
    assert np.all(lowest[:, 0] >= -1e-12 * lowest[:, -1])
    np.testing.assert_allclose(value[:100], MU_LAMBDA * EPS_U / 3)
    assert np.all(gradient[:100] == 0.0)
    plane = np.eye(3) - n[:100, :, None] * n[:100, None, :]
    np.testing.assert_allclose(hessian[:100], 2 * MU_LAMBDA / EPS_U * plane, rtol=1e-12, atol=1e-9)


def test_tangent_basis_is_a_right_handed_frame_everywhere() -> None:
    rng = np.random.default_rng(5)
    n = rng.normal(size=(2000, 3))
    axes = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1, 0, -0.0]]
    nearly = [[1e-9, 0, -1], [0, 1e-200, 1], [-1e-200, 0, -1]]
    n = np.concatenate([n, np.array(axes + nearly, dtype=float)])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    basis = batch.tangents(n)
    frame = np.concatenate([basis, n[:, None]], axis=1)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.tile(np.eye(3), (len(n), 1, 1)),
                               atol=1e-14)  # fmt: skip
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, rtol=1e-14)


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
    dts = wp.full(1, model.scene.time.dt_s, dtype=wp.float64)
    friction.begin_step(wp.full(1, 1, dtype=wp.int32), dts, dts)
    x, then = assembly.nodal(now), assembly.nodal(before)
    friction.lag(assembly.active, x, then)
    poses = [wp.array(p, dtype=wp.transformd) for p in (end, start)]
    gradient = assembly.nodal()
    motion = step_motion(model, x, then, poses[0], poses[1])
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
