# SPDX-License-Identifier: Apache-2.0
"""An environment with many contacts costs its own memory, and is given up alone."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.ipc.device import ragged_lists
from taccel_lab.outputs import Outputs
from taccel_lab.scene import Element, KinematicBody, Material, Scene, SoftBody, box_mesh
from taccel_lab.solvers import EnvStatus, SolverIPC, StepReport
from taccel_lab.state import State
from tests.solvers.steps import assert_same, begun, left, stepped
from tests.support.blocks import block_mesh, everywhere, pose, scene

MESH = block_mesh((12, 12, 1), (6e-3, 6e-3, 1e-3))
PLATE = box_mesh((8e-3, 8e-3, 2e-3))
DHAT = 1e-4
CROWDED = 5
ROOM = 160
ENVS = 8
OTHERS = np.arange(ENVS) != CROWDED
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
    """Steps down from gap to gap, with room for ``ROOM`` at first."""
    made = scene(MESH, KinematicBody(PLATE, 0.5), env_count=len(envs))
    start, *targets = (np.stack([plate(env, gap)[None] for env in envs]) for gap in gaps)
    solver, state = begun(made, start, dhat_m=DHAT, **options)
    for part in solver.lists:
        part.rooms[:] = ROOM
        part.renew()
    return solver, state, [solver.step(state, target) for target in targets][-1]


def assert_as_alone(
    solver: SolverIPC, state: State, env: int, gaps: tuple[float, ...] = GAPS
) -> None:
    alone, own, report = touch([env], gaps)
    assert report.converged.all()
    assert_same(left(solver, state, env), left(alone, own, 0))
    for part, its in zip(solver.lists, alone.lists, strict=True):
        assert part.rooms[env] == its.rooms[0]
    for wrenches in ("contact_wrenches", "friction_wrenches"):
        found = getattr(Outputs(solver).update(state), wrenches)()
        expected = getattr(Outputs(alone).update(own), wrenches)()
        for name in ("wrenches", "gaps"):
            mine, its = (getattr(part, name).numpy() for part in (found, expected))
            np.testing.assert_array_equal(mine[env], its[0])


@pytest.mark.thorough
def test_many_contacts_cost_the_memory_of_their_environment() -> None:
    solver, state, report = touch(list(range(ENVS)))
    assert report.converged.all(), report.summary()
    counts = solver.collisions.counts.numpy()
    assert counts[OTHERS].min() > 0 and counts[CROWDED] >= 50 * counts[OTHERS].max()
    collisions = solver.collisions
    assert collisions.rooms[CROWDED] >= counts[CROWDED] > ROOM
    for part in solver.lists:
        assert (part.rooms[OTHERS] == ROOM).all(), "as at first"
    # kind, stencil, stiffness, threshold, range, inset.
    entry = 4 + 16 + 8 + 8 + 8 + 8
    held = sum(getattr(collisions, name).capacity for name in collisions.columns)
    assert held == entry * collisions.capacity
    assert 1 <= collisions.capacity / (collisions.rooms[CROWDED] + 7 * ROOM) <= 1.125
    assert len(solver.contact.energies) == collisions.capacity and solver.friction is not None
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


def test_a_way_that_meets_too_much_is_taken_in_parts() -> None:
    knife = box_mesh((4e-4, 8e-3, 2e-3))
    start, end = (everywhere(1, pose(x, 0, 1e-3 + 1.05e-4)) for x in (-2.5e-3, 2.5e-3))
    for most, parts in ((1 << 20, 1), (1500, 2)):
        made = begun(scene(MESH, KinematicBody(knife)), start, dhat_m=DHAT, max_collisions=most)
        assert stepped(*made, end).substeps.tolist() == [parts]


@pytest.mark.thorough(cases=("limit",))
@pytest.mark.parametrize("short", ["limit", "memory"])
def test_beyond_the_limit_or_without_memory_one_environment_is_given_up(
    short: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = {"max_collisions": 165} if short == "limit" else {}
    with monkeypatch.context() as patch:
        if short == "memory":
            patch.setattr(ragged_lists, "free_memory", lambda device: 20_000)
        solver, state, report = touch(list(range(ENVS)), **options)
    assert report.status[CROWDED] == EnvStatus.CONTACT_OVERFLOW
    assert (report.status[OTHERS] == EnvStatus.CONVERGED).all()
    if short == "limit":
        assert all(part.rooms[CROWDED] == ROOM for part in solver.lists)
        assert_as_alone(solver, state, ENVS - 1)
    assert_as_alone(solver, state, 0)


def squeezed(*lowest: float) -> tuple[SolverIPC, State, list[list[int]], StepReport]:
    """Two gels on mounts from 1 mm apart to ``lowest`` [m] in each environment, in three steps; the
    rooms for trees among gels after each, and the last report."""
    names = ("low", "high")
    mesh = block_mesh((4, 4, 2), (2e-3, 2e-3, 1e-3), jitter=0.2)
    gels = [
        SoftBody(mesh, Material(1e5, 0.4), name=n, mount=f"{n} mount", element=Element.LINEAR)
        for n in names
    ]
    made = Scene(gels, [KinematicBody(None, name=f"{n} mount") for n in names], len(lowest))

    def at(part: float) -> np.ndarray:
        gaps = [1e-3 + part * (end - 1e-3) for end in lowest]
        above = [pose(0, 0, gap, (1, 0, 0), 180) for gap in gaps]
        return np.stack([[pose(0, 0, 0), high] for high in above])

    solver, state = begun(made, at(0.0), dhat_m=DHAT)
    rooms, reports = [], []
    for part in (0.3, 0.98, 1.0):
        reports.append(solver.step(state, at(part)))
        rooms.append(solver.candidates.lists[2].rooms.tolist())
    return solver, state, rooms, reports[-1]


def test_trees_among_gels_are_made_when_the_first_come_near_each_other() -> None:
    solver, state, rooms, report = squeezed(1e-3, -5e-5, 1e-3)
    assert report.converged.all() and rooms == [[0, 0, 0], [0, 1, 0], [0, 1, 0]]
    assert solver.collisions.counts.numpy()[1] > 10
    for env, lowest in ((1, -5e-5), (2, 1e-3)):
        alone, own, its_rooms, _ = squeezed(lowest)
        assert its_rooms[-1] == [int(env == 1)]
        assert_same(left(solver, state, env), left(alone, own, 0))


def test_without_memory_for_trees_those_are_given_up_that_need_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ragged_lists, "free_memory", lambda device: 20_000)
    _, _, rooms, report = squeezed(1e-3, -5e-5)
    assert rooms[-1] == [0, 0]
    assert report.status.tolist() == [EnvStatus.CONVERGED, EnvStatus.CONTACT_OVERFLOW]
