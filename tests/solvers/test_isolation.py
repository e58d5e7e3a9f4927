# SPDX-License-Identifier: Apache-2.0
"""What goes wrong in one environment stays there, is named, and can be reset."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.contact.overlap_search import require_separated
from taccel_lab.model import Model
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    Plane,
    Scene,
    SoftBody,
    TimeScheme,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.step_report import EnvStatus
from taccel_lab.state import State, initial_state
from tests.support.blocks import pose
from tests.support.variants import variants

MESH = block_mesh((3, 3, 2), (3e-3, 3e-3, 2e-3), jitter=0.15)
SIDE = 1.2e-3
STEPS = 3


def model_of(envs: list[int], scheme: TimeScheme = TimeScheme.EULER) -> Model:
    """A cube falls on a gel beside a floor while a ball comes down; each environment differs."""
    cube = AffineBody(
        box_mesh((SIDE,) * 3),
        8000,
        friction_coefficient=0.4,
        name="cube",
        initial_pose=np.stack(
            [pose(1e-4 * e, 0, SIDE / 2 + 2e-5 + 3e-6 * e, (0, 0, 1), 10.0 * e) for e in envs]
        ),
        initial_velocity_m_s=(0.0, 0.0, -0.05),
    )
    return Scene(
        SoftBody(MESH, Material(1e5, 0.4), friction_coefficient=0.4, element=Element.LINEAR),
        KinematicBody(Ball(1e-3), 0.4, name="ball"),
        len(envs),
        TimeStepping(False, 2e-3, (0, 0, -9.81), scheme),
        affine_bodies=cube,
        planes=Plane((0, 0, -2.5e-3), name="floor"),
    ).finalize()


def ball_at(envs: list[int], step: int) -> np.ndarray:
    z = SIDE + 1e-3 + 1.5e-4 - 6e-5 * step
    return np.stack([pose(1e-4 * e, 1e-5 * e * step, z)[None] for e in envs])


Spoil = Callable[[Model, State], None]


def run(
    envs: list[int], spoil: Spoil | None = None, scheme: TimeScheme = TimeScheme.EULER
) -> tuple[SolverIPC, State, list[np.ndarray]]:
    """Some steps of the given environments; ``spoil`` gets the state after the first."""
    model = model_of(envs, scheme)
    solver = SolverIPC(model, SolverConfig(relative_tolerance=1e-6))
    state = initial_state(model, ball_at(envs, 0))
    statuses = []
    for k in range(1, STEPS + 1):
        report = solver.step(state, ball_at(envs, k))
        statuses.append(report.status)
        if k == 1:
            assert report.converged.all(), report.summary()
            if spoil is not None:
                spoil(model, state)
    return solver, state, statuses


def moved(state: State, name: str, env: int, node: int, by: tuple[float, float, float]) -> None:
    array = getattr(state, name)
    value = array.numpy().copy()
    value[env, node] += by
    array.assign(value)


def nan_velocity(model: Model, state: State) -> None:
    moved(state, "velocities", 1, model.affine.first_control, (np.nan, 0, 0))


def nan_position(model: Model, state: State) -> None:
    moved(state, "positions", 1, 20, (np.nan, 0, 0))


def inverted(model: Model, state: State) -> None:
    top = int(MESH.nodes_m[:, 2].argmax())
    moved(state, "positions", 1, top, (0, 0, -1.9e-3))


SPOILS = {
    nan_velocity: EnvStatus.NOT_A_NUMBER,
    nan_position: EnvStatus.NOT_A_NUMBER,
    inverted: EnvStatus.INVERSION,
}


def left(solver: SolverIPC, state: State, env: int) -> list[np.ndarray]:
    """What a step leaves in an environment."""
    arrays = (state.positions, state.velocities, solver.contact_gradient, solver.friction_gradient)
    return [array.numpy()[env].copy() for array in arrays]


@cache
def run_alone(env: int, scheme: TimeScheme) -> list[np.ndarray]:
    solver, state, _ = run([env], scheme=scheme)
    return left(solver, state, 0)


@pytest.mark.thorough(cases=("bdf2-nan_velocity", "euler-nan_position", "euler-nan_velocity"))
@pytest.mark.parametrize(
    ("scheme", "spoil"),
    variants(
        [*product([TimeScheme.EULER], SPOILS), (TimeScheme.BDF2, nan_velocity)], TimeScheme, SPOILS
    ),
)
def test_others_are_bitwise_as_if_alone_and_a_reset_starts_anew(
    spoil: Spoil, scheme: TimeScheme
) -> None:
    before: list[np.ndarray] = []

    def spoil_and_look(model: Model, state: State) -> None:
        spoil(model, state)
        before.extend(a.numpy()[1].copy() for a in (state.positions, state.velocities, state.poses))

    envs = [0, 1, 2]
    solver, state, statuses = run(envs, spoil_and_look, scheme)
    assert statuses[1].tolist() == [EnvStatus.CONVERGED, SPOILS[spoil], EnvStatus.CONVERGED]
    assert statuses[2][1] != EnvStatus.CONVERGED
    for array, old in zip((state.positions, state.velocities, state.poses), before, strict=True):
        np.testing.assert_array_equal(array.numpy()[1], old, "it keeps the start of the step")
    together = {env: left(solver, state, env) for env in (0, 2)}
    for env, found in together.items():
        for one, other in zip(found, run_alone(env, scheme), strict=True):
            np.testing.assert_array_equal(one, other)
        assert all(np.abs(force).max() > 1e-6 for force in found[2:])

    solver.reset(state, np.array([False, True, False]), ball_at(envs, 0))
    for env, found in together.items():
        for one, other in zip(left(solver, state, env)[:2], found, strict=False):
            np.testing.assert_array_equal(one, other)
    # From here on it does what an environment that never failed does, bit by bit.
    only = model_of([1], scheme)
    alone_solver = SolverIPC(only, SolverConfig(relative_tolerance=1e-6))
    alone = initial_state(only, ball_at([1], 0))
    np.testing.assert_array_equal(state.positions.numpy()[1], alone.positions.numpy()[0])
    np.testing.assert_array_equal(state.velocities.numpy()[1], alone.velocities.numpy()[0])
    for k in (1, 2):
        targets = ball_at(envs, STEPS)
        targets[1] = ball_at([1], k)[0]
        report = solver.step(state, targets)
        assert report.converged.all(), report.summary()
        assert alone_solver.step(alone, ball_at([1], k)).converged.all()
        found, expected = left(solver, state, 1), left(alone_solver, alone, 0)
        np.testing.assert_array_equal(found[0], expected[0])
        np.testing.assert_array_equal(found[3], expected[3])


def test_bodies_that_start_inside_each_other_are_flagged_and_refused() -> None:
    """Environment 1 starts with the cube in the gel, 2 with the ball in the cube."""
    model = model_of([0, 1, 2])
    solver = SolverIPC(model, SolverConfig(relative_tolerance=1e-6))
    balls = ball_at([0, 1, 2], 0)
    state = initial_state(model, balls)
    require_separated(model, state)
    first = model.affine.first_control
    cube = [first, *range(*model.bodies[1].nodes)]
    x = state.positions.numpy().copy()
    x[1, cube, 2] -= 0.3e-3
    state.positions.assign(x)
    with pytest.raises(InputError, match=r"'cube'.*in environment 1.*\(edge \d+, \d+ of"):
        require_separated(model, state)
    before = state.positions.numpy()[1].copy()
    report = solver.step(state, ball_at([0, 1, 2], 1))
    expected = [EnvStatus.CONVERGED, EnvStatus.OVERLAP, EnvStatus.CONVERGED]
    assert report.status.tolist() == expected
    assert report.failures() == {"OVERLAP": [1]}
    np.testing.assert_array_equal(state.positions.numpy()[1], before)
    # Not once and then forgotten; and a reset puts it right.
    assert solver.step(state, ball_at([0, 1, 2], 2)).status.tolist() == expected
    solver.reset(state, np.array([False, True, False]), balls)
    targets = ball_at([0, 1, 2], 3)
    targets[1] = ball_at([1], 1)[0]
    assert solver.step(state, targets).converged.all()
