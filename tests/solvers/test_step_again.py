# SPDX-License-Identifier: Apache-2.0
"""Steps of some environments, and steps that are taken again to other targets."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.scene import Ball, KinematicBody, TimeStepping
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, everywhere, pose, scene

RADIUS = 2e-3
MESH = block_mesh((6, 6, 2), (4e-3, 4e-3, 1e-3))
CONFIG = SolverConfig(relative_tolerance=1e-6)


def pressed(env_count: int = 1) -> tuple[SolverIPC, State]:
    """A ball 0.1 mm deep in a gel, friction 0.5."""
    model = scene(MESH, KinematicBody(Ball(RADIUS), 0.5), env_count=env_count).finalize()
    solver = SolverIPC(model, CONFIG)
    state = initial_state(model, everywhere(env_count, pose(0, 0, RADIUS + 5e-5)))
    assert solver.step(state, at(0, -1e-4, env_count)).converged.all()
    return solver, state


def at(x: float, z: float, env_count: int = 1) -> np.ndarray:
    return everywhere(env_count, pose(x, 0, RADIUS + z))


def forces(solver: SolverIPC) -> np.ndarray:
    """Normal and friction force on all nodes of the gel [N], [env_count, 2, 3]."""
    soft = slice(0, solver.model.soft_count)
    parts = (solver.contact_gradient, solver.friction_gradient)
    return np.stack([part.numpy()[:, soft].sum(axis=1) for part in parts], axis=1)


def test_a_step_taken_again_is_the_step_to_the_other_target() -> None:
    solver, state = pressed()
    start = state.copy()
    other = at(3e-5, -1.02e-4)
    first = solver.step(state, at(3e-5, -1.0e-4))
    again = solver.step(state, other, again=True)
    assert first.converged.all() and again.converged.all()
    assert again.newton_iterations[0] < first.newton_iterations[0]
    found, x, v = forces(solver), state.positions.numpy(), state.velocities.numpy()
    assert solver.step(start, other).converged.all()
    expected = forces(solver)
    size = float(np.linalg.norm(expected))
    assert np.abs(expected[0, 1, 0]) > 0.1 * size, "it is sheared"
    np.testing.assert_allclose(found, expected, atol=1e-4 * size)
    np.testing.assert_allclose(x, start.positions.numpy(), atol=2e-9)
    np.testing.assert_allclose(v, start.velocities.numpy(), atol=1e-4 * float(np.abs(v).max()))
    # As a step of its own, in which nothing moves, it keeps what friction holds.
    solver.step(start, other)
    np.testing.assert_allclose(forces(solver), expected, atol=1e-4 * size)


def test_environments_that_are_not_asked_for_keep_every_bit() -> None:
    solver, state = pressed(2)
    assert solver.step(state, at(3e-5, -1e-4, 2)).converged.all()
    arrays = (state.positions, state.velocities, state.poses)
    before = [array.numpy()[1].copy() for array in arrays]
    kept = forces(solver)[1]
    for again in (False, True):
        report = solver.step(state, at(6e-5, -1.1e-4, 2), who=np.array([True, False]), again=again)
        assert report.status.tolist() == [EnvStatus.CONVERGED, EnvStatus.SKIPPED]
        for array, value in zip(arrays, before, strict=True):
            np.testing.assert_array_equal(array.numpy()[1], value)
        np.testing.assert_array_equal(forces(solver)[1], kept)
    assert solver.step(state, at(3e-5, -1e-4, 2)).converged.all()


def test_what_has_inertia_is_not_taken_again() -> None:
    time = TimeStepping(dt_s=0.01, quasi_static=False)
    model = scene(MESH, KinematicBody(Ball(RADIUS)), time=time).finalize()
    solver = SolverIPC(model)
    state = initial_state(model, at(0, 1e-4))
    solver.step(state)
    with pytest.raises(InputError, match="quasi-static"):
        solver.step(state, again=True)
