# SPDX-License-Identifier: Apache-2.0
"""When a step counts as converged: each body by its own forces, residual and force in one norm."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state
from tests.verification.blocks import everywhere, pose

MESH = block_mesh((4, 4, 2), (6e-3, 6e-3, 2e-3), jitter=0.1)
CONFIG = SolverConfig(absolute_tolerance_n=1e-10)
ASIDE = 0.05
"""Where the second gel is [m]."""


@lru_cache
def pressed(*youngs_pa: float) -> tuple[SolverIPC, np.ndarray]:
    """Gels of these stiffnesses beside one another, each pressed by a ball of its own: the solver
    and the force on each ball [N], [gel]."""
    shift = ASIDE * np.arange(len(youngs_pa))
    gels = [
        SoftBody(
            MESH,
            Material(young, 0.4),
            name=f"gel {i}",
            initial_pose=pose(shift[i], 0, 0),
            element=Element.QUADRATIC,
        )
        for i, young in enumerate(youngs_pa)
    ]
    balls = [KinematicBody(Ball(2e-3), name=f"ball {i}") for i in range(len(gels))]
    model = Scene(gels, balls).finalize()
    start, end = (
        everywhere(1, *(pose(x + 1e-4, 0, 2e-3 + z) for x in shift)) for z in (5e-5, -3e-4)
    )
    solver, state = SolverIPC(model, CONFIG), initial_state(model, start)
    report = solver.step(state, end)
    assert report.converged[0], report.summary()
    assert report.residual_ratio[0] <= 1
    x = solver.contact_gradient.numpy()[0]
    return solver, np.array([x[model.bodies[len(gels) + i].nodes[0], 2] for i in range(len(gels))])


def test_a_soft_body_is_solved_beside_a_stiff_one() -> None:
    """A gel of 100 Pa beside one of 100 MPa: its force is that of the gel alone."""
    (alone,) = pressed(1e2)[1]
    solver, forces = pressed(1e8, 1e2)
    assert abs(forces[0]) > 1e4 * abs(alone)
    assert forces[1] == pytest.approx(alone, rel=2e-4)
    p = solver.progress.data
    residuals, contact = p.body_residuals.numpy()[0], p.body_forces.numpy()[0]
    assert (residuals[:2] <= 1.0001e-4 * contact[:2]).all()
    # Prescribed bodies have no residual, but feel the contact.
    assert (residuals[2:] == 0).all() and (contact[2:] > 0).all()


def test_residual_and_contact_force_are_sums_of_magnitudes() -> None:
    solver, _ = pressed(1e5)
    model, p = solver.model, solver.progress.data
    left = np.linalg.norm(solver.reduced.numpy()[0], axis=1).sum()
    assert p.body_residuals.numpy()[0, 0] == pytest.approx(left, rel=1e-12)
    contact = np.linalg.norm(solver.contact_gradient.numpy()[0], axis=1)
    both = [contact[body.node_slice].sum() for body in model.bodies]
    np.testing.assert_allclose(p.body_forces.numpy()[0], both, rtol=1e-12)
    assert p.residual.numpy()[0] == pytest.approx(left, rel=1e-12)
    assert p.contact_force.numpy()[0] == pytest.approx(0.5 * sum(both), rel=1e-12)


@pytest.mark.parametrize("bad", ["first", "last"])
def test_a_body_that_is_not_a_number_is_not_lost_among_others(bad: str) -> None:
    shift = 0 if bad == "first" else 1
    model = pressed(1e5, 1e4)[0].model
    solver, state = SolverIPC(model, CONFIG), initial_state(model)
    loads = np.zeros((1, model.node_count, 3))
    loads[0, model.bodies[shift].node_slice] = 1e200
    state.load(model, loads)
    poses = everywhere(1, pose(0, 0, 9e-3), pose(ASIDE, 0, 9e-3))
    state.poses.assign(poses.reshape(1, 2, 7))
    assert not solver.step(state).converged[0]
