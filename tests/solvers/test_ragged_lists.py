# SPDX-License-Identifier: Apache-2.0
"""An environment with many contacts costs its own memory, and is given up alone."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.ipc.device import ragged_lists
from taccel_lab.outputs import Outputs
from taccel_lab.scene import KinematicBody, box_mesh
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC
from taccel_lab.solvers.step_report import StepReport
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, pose, scene

MESH = block_mesh((12, 12, 1), (6e-3, 6e-3, 1e-3))
PLATE = box_mesh((8e-3, 8e-3, 2e-3))
DHAT = 1e-4
CROWDED = 5
ROOM = 160
ENVS = 8
CORNER = np.linalg.norm([4e-3, 4e-3, 1e-3])


def plate(env: int, gap: float) -> np.ndarray:
    """A plate at a distance from the gel: flat in one environment, in the others on a corner."""
    if env == CROWDED:
        return pose(0, 0, 1e-3 + gap)
    # The corner (1, 1, -1) turned down: its direction goes to -z.
    down = np.array([4e-3, 4e-3, -1e-3]) / CORNER
    axis = np.cross(down, [0, 0, -1])
    angle = np.degrees(np.arccos(-down[2]))
    x = 5e-4 * (env - 3) + 1.2e-4
    return pose(x, 1e-4, CORNER + gap + 1e-6 * env, tuple(axis), angle)


GAPS = (1.2e-4, 0.6e-4, 0.2e-4)


def touch(
    envs: list[int], gaps: tuple[float, ...] = GAPS, **options: int
) -> tuple[SolverIPC, State, StepReport]:
    """Steps down from gap to gap in the given environments, whose lists have room for ``ROOM``
    at first."""
    model = scene(MESH, KinematicBody(PLATE, 0.5), env_count=len(envs)).finalize()
    solver = SolverIPC(model, SolverConfig(dhat_m=DHAT, **options))  # type: ignore[arg-type]
    for part in solver.lists:
        part._allocate(ROOM)

    def at(gap: float) -> np.ndarray:
        return np.stack([plate(env, gap)[None] for env in envs])

    state = initial_state(model, at(gaps[0]))
    reports = [solver.step(state, at(gap)) for gap in gaps[1:]]
    return solver, state, reports[-1]


def assert_as_alone(
    solver: SolverIPC, state: State, env: int, gaps: tuple[float, ...] = GAPS
) -> None:
    """Same bits, same rooms, and the same forces read out."""
    alone, own, report = touch([env], gaps)
    assert report.converged.all()
    np.testing.assert_array_equal(state.positions.numpy()[env], own.positions.numpy()[0])
    for name in ("contact_gradient", "friction_gradient"):
        together = getattr(solver, name).numpy()[env]
        np.testing.assert_array_equal(together, getattr(alone, name).numpy()[0])
    for part, its in zip(solver.lists, alone.lists, strict=True):
        assert part.rooms[env] == its.rooms[0]
    for wrenches in ("contact_wrenches", "friction_wrenches"):
        found = getattr(Outputs(solver).update(state), wrenches)()
        expected = getattr(Outputs(alone).update(own), wrenches)()
        np.testing.assert_array_equal(found.wrenches.numpy()[env], expected.wrenches.numpy()[0])
        np.testing.assert_array_equal(found.gaps.numpy()[env], expected.gaps.numpy()[0])


@pytest.mark.thorough
def test_many_contacts_cost_the_memory_of_their_environment() -> None:
    solver, state, report = touch(list(range(ENVS)))
    assert report.converged.all(), report.summary()
    others = np.arange(ENVS) != CROWDED
    counts = solver.collisions.counts.numpy()
    assert counts[others].min() > 0 and counts[CROWDED] >= 50 * counts[others].max()
    collisions = solver.collisions
    assert collisions.rooms[CROWDED] >= counts[CROWDED] > ROOM
    for part in solver.lists:
        assert (part.rooms[others] == ROOM).all(), "as at first"
    # kind, stencil, stiffness, threshold, range, inset.
    entry = 4 + 16 + 8 + 8 + 8 + 8
    held = sum(getattr(collisions, name).capacity for name in collisions.columns)
    assert held == entry * (collisions.rooms[CROWDED] + 7 * ROOM)
    assert len(solver.contact.energies) == collisions.capacity
    assert solver.friction is not None
    assert len(solver.friction.frozen.stencils) == collisions.capacity
    for env in (0, CROWDED, ENVS - 1):
        assert_as_alone(solver, state, env)


def test_what_the_others_list_stays_while_one_grows() -> None:
    """They have arrived when the step is taken again where the list was too short."""
    gaps = (0.35e-4, 0.2e-4)
    solver, state, report = touch(list(range(ENVS)), gaps)
    assert report.converged.all() and solver.collisions.rooms[CROWDED] > ROOM
    for env in (0, CROWDED, ENVS - 1):
        assert_as_alone(solver, state, env, gaps)


@pytest.mark.thorough
def test_beyond_the_limit_one_environment_is_given_up() -> None:
    solver, state, report = touch(list(range(ENVS)), max_collisions=165)
    others = np.arange(ENVS) != CROWDED
    assert report.status[CROWDED] == EnvStatus.CONTACT_OVERFLOW
    assert (report.status[others] == EnvStatus.CONVERGED).all()
    for part in solver.lists:
        assert part.rooms[CROWDED] == ROOM
    for env in (0, ENVS - 1):
        assert_as_alone(solver, state, env)


def test_a_way_that_meets_too_much_is_taken_in_parts() -> None:
    knife = box_mesh((4e-4, 8e-3, 2e-3))
    model = scene(MESH, KinematicBody(knife)).finalize()

    def at(x: float) -> np.ndarray:
        return pose(x, 0, 1e-3 + 1.05e-4)[None, None]

    for most, parts in ((1 << 20, 1), (1500, 2)):
        solver = SolverIPC(model, SolverConfig(dhat_m=DHAT, max_collisions=most))
        report = solver.step(initial_state(model, at(-2.5e-3)), at(2.5e-3))
        assert report.converged.all(), report.summary()
        assert report.substeps.tolist() == [parts]


def test_without_memory_one_environment_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ragged_lists, "free_memory", lambda device: 20_000)
    solver, state, report = touch(list(range(ENVS)))
    others = np.arange(ENVS) != CROWDED
    assert report.status[CROWDED] == EnvStatus.CONTACT_OVERFLOW
    assert (report.status[others] == EnvStatus.CONVERGED).all()
    monkeypatch.undo()
    assert_as_alone(solver, state, 0)
