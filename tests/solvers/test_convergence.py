# SPDX-License-Identifier: Apache-2.0
"""When a step counts as converged: each body by its own forces, residual and force in one norm."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry.block import block_mesh, free_block
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import everywhere, pose

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
    p = solver.progress.balance
    residuals, contact = p.body_residuals.numpy()[0], p.body_forces.numpy()[0]
    assert (residuals[:2] <= 1.0001e-4 * contact[:2]).all()
    # Prescribed bodies have no residual, but feel the contact.
    assert (residuals[2:] == 0).all() and (contact[2:] > 0).all()


def test_residual_and_contact_force_are_sums_of_magnitudes() -> None:
    solver, _ = pressed(1e5)
    model, p = solver.model, solver.progress.balance
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


def moving(
    soft: SoftBody, *bodies: AffineBody, config: SolverConfig, speed: float = 0.1
) -> tuple[SolverIPC, float, np.ndarray]:
    """The solver of a step in which a soft body begins to shear by so many lengths a second, its
    residual [N], and whether it converged."""
    time = TimeStepping(quasi_static=False, dt_s=1e-3)
    model = Scene(soft, affine_bodies=bodies, time=time).finalize()
    solver, state = SolverIPC(model, config), initial_state(model, np.zeros((1, 0, 7)))
    x, v = state.positions.numpy(), state.velocities.numpy()
    v[0, :, 0] = speed * (x[0, :, 2] - x[0, :, 2].mean())
    state.velocities.assign(v)
    report = solver.step(state)
    return solver, float(report.residual_n[0]), report.converged


STIFF = Material(7e10, 0.3, 2700.0)
FREE = np.zeros(0, dtype=np.int64)
STIFF_BLOCKS = {
    "linear": SoftBody(free_block((8, 8, 8), 0.02, 0.2), STIFF, FREE, element=Element.LINEAR),
    "quadratic": SoftBody(free_block((4, 4, 4), 0.02, 0.2), STIFF, FREE, element=Element.QUADRATIC),
    "far away": SoftBody(
        free_block((2, 2, 2), 0.02, 0.2),
        STIFF,
        FREE,
        initial_pose=pose(1.0, 1.0, 1.0),
        element=Element.QUADRATIC,
    ),
}


@pytest.mark.parametrize("name", STIFF_BLOCKS)
def test_a_stiff_body_stops_at_what_rounding_leaves(name: str) -> None:
    """Not at a force that no step reaches; what is allowed is near that of the last digit of the
    positions alone, which at rest is all there is."""
    once = SolverConfig(max_substep_halvings=0, max_newton_iterations=12)
    solver, residual, converged = moving(STIFF_BLOCKS[name], config=once)
    assert converged.all()
    allowed = residual / float(solver.progress.balance.excess.numpy()[0])
    assert allowed > SolverConfig.absolute_tolerance_n
    least = last_digit_n(solver)
    assert least < allowed < 5 * least


def last_digit_n(solver: SolverIPC) -> float:
    """Elastic forces of the resting body with the last digit of its positions drawn [N], summed."""
    model = solver.model
    x = initial_state(model, np.zeros((1, 0, 7))).positions.numpy()
    x *= 1 + np.finfo(float).eps * np.random.default_rng(1).integers(-1, 2, x.shape) / 2
    gradient = wp.zeros((1, model.node_count), dtype=wp.vec3d)
    mask = wp.ones(1, dtype=wp.int32)
    solver.elastic[0].add_gradient(mask, wp.array(x, dtype=wp.vec3d), gradient)
    return float(np.linalg.norm(gradient.numpy()[0], axis=1).sum())


def test_a_stiff_gel_on_a_body_converges_with_it() -> None:
    """What rounding leaves in a gel acts on the body that carries it, too."""
    base = AffineBody(box_mesh((0.03, 0.03, 0.01)), 1000.0, name="base")
    gel = SoftBody(
        block_mesh((4, 4, 4), (0.02, 0.02, 0.02), jitter=0.1),
        STIFF,
        mount="base",
        element=Element.QUADRATIC,
    )
    config = SolverConfig(max_substep_halvings=0, max_newton_iterations=12)
    assert moving(gel, base, config=config)[2].all()


def test_soft_gels_are_not_asked_for_their_rounding() -> None:
    model = Scene(SoftBody(MESH, Material(1e6, 0.49), element=Element.QUADRATIC)).finalize()
    assert not any(part.rounds_above(1e-7) for part in SolverIPC(model).elastic)
    model.set_body(model.bodies[0].name, young_modulus_pa=1e11)
    assert all(part.rounds_above(1e-7) for part in SolverIPC(model).elastic)
