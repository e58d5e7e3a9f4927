# SPDX-License-Identifier: Apache-2.0
"""Environments do not see each other: results, order, failures and roll-back."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    MaterialModel,
    Scene,
    SoftBody,
    TimeStepping,
    TriangleMesh,
    box_mesh,
    sphere_mesh,
)
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.step_report import EnvStatus, StepReport
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, pose, scene
from tests.support.intersection import find_intersections

CELLS, SIZE = (6, 6, 2), (5e-3, 5e-3, 2e-3)
MESH = block_mesh(CELLS, SIZE)
RESTS = np.stack([block_mesh(CELLS, SIZE, jitter=0.15, seed=s).nodes_m for s in range(4)])
START_Z = 1.55e-3
SHAPES = {"ball": Ball(1.5e-3), "mesh": sphere_mesh(1.5e-3, 5e-4)}


def targets(env: int) -> list[np.ndarray]:
    """Each environment presses elsewhere, to another depth, with another turn."""
    x, depth, deg = 2e-4 * env, 1e-4 + 5e-5 * env, 1.5 * env
    return [
        pose(x, 0, 1.5e-3 - depth),
        pose(x + 5e-5, 1e-5 * env, 1.5e-3 - 1.5 * depth, (0, 1, 2), deg),
    ]


def press(
    envs: list[int], shape: TriangleMesh | Ball, friction: float, steps: int = 2
) -> tuple[np.ndarray, np.ndarray, list[StepReport]]:
    """Positions and contact forces of the soft nodes in the given environments, in this order."""
    made = scene(MESH, KinematicBody(shape, friction), env_count=len(envs), rest_m=RESTS[envs])
    model = made.finalize()
    solver = SolverIPC(model, SolverConfig())
    start = np.stack([pose(2e-4 * env, 0, START_Z)[None] for env in envs])
    state = initial_state(model, start)
    reports = []
    for k in range(steps):
        reports.append(solver.step(state, np.stack([targets(env)[k][None] for env in envs])))
        assert reports[-1].converged.all(), reports[-1].summary()
    return state.positions.numpy(), solver.contact_gradient.numpy(), reports


@pytest.mark.thorough(cases=("ball-0.8", "mesh-0.8"))
@pytest.mark.parametrize("friction", [0.0, 0.8])
@pytest.mark.parametrize("shape", SHAPES)
def test_results_do_not_depend_on_number_and_order(shape: str, friction: float) -> None:
    """Bitwise on the CPU, where lists are filled and summed in a fixed order."""
    together, forces, reports = press([0, 1, 2, 3], SHAPES[shape], friction)
    shuffled, shuffled_forces, _ = press([2, 0, 3, 1], SHAPES[shape], friction)
    np.testing.assert_array_equal(shuffled, together[[2, 0, 3, 1]])
    np.testing.assert_array_equal(shuffled_forces, forces[[2, 0, 3, 1]])
    alone, alone_forces, alone_reports = press([3], SHAPES[shape], friction)
    np.testing.assert_array_equal(alone[0], together[3])
    np.testing.assert_array_equal(alone_forces[0], forces[3])
    for name in ("newton_iterations", "cg_iterations", "residual_n", "min_distance_m"):
        assert getattr(alone_reports[-1], name)[0] == getattr(reports[-1], name)[3]
    assert len(np.unique(forces[:, : MESH.node_count, 2].sum(axis=1))) == 4, (
        "the environments were meant to differ"
    )


def _snapshot(state: State) -> list[np.ndarray]:
    return [a.numpy().copy() for a in (state.positions, state.velocities, state.poses)]


@pytest.mark.parametrize("quasi_static", [True, False])
def test_a_failing_environment_is_rolled_back_and_the_others_go_on(quasi_static: bool) -> None:
    """Environment 1 has too far to go for the iterations it is given."""
    stepping = TimeStepping(quasi_static=quasi_static, dt_s=0.01)
    made = scene(MESH, KinematicBody(SHAPES["ball"]), env_count=3, time=stepping)
    model = made.finalize()
    solver = SolverIPC(model, SolverConfig())
    state = initial_state(model, np.tile(pose(0, 0, START_Z), (3, 1, 1)))
    first = np.tile(pose(0, 0, 1.45e-3), (3, 1, 1))
    assert solver.step(state, first).converged.all()
    before = _snapshot(state)
    if not quasi_static:
        assert np.abs(before[1]).max() > 0

    few = SolverConfig(max_newton_iterations=4, relative_tolerance=1e-3, max_substep_halvings=0)
    hasty = SolverIPC(model, few)
    target = first.copy()
    target[0, 0, 2] -= 1e-6
    target[1, 0, 2] -= 4e-4
    report = hasty.step(state, target)
    assert report.status.tolist() == [
        EnvStatus.CONVERGED,
        EnvStatus.NO_CONVERGENCE,
        EnvStatus.CONVERGED,
    ]
    after = _snapshot(state)
    for value, old in zip(after, before, strict=True):
        np.testing.assert_array_equal(value[1], old[1])
    assert np.abs(after[0][0] - before[0][0]).max() > 1e-7
    np.testing.assert_allclose(after[2].reshape(3, 7)[0], target[0, 0], atol=1e-15)
    assert find_intersections(model, state) == [[], [], []]
    # The forces that are read out belong to the state that is left, also where it was rolled back.
    again = SolverIPC(model, SolverConfig())
    copy = State(*(wp.clone(a) for a in (state.positions, state.velocities, state.poses)))
    again.step(copy)
    old, new = hasty.contact_gradient.numpy()[1], again.contact_gradient.numpy()[1]
    assert np.abs(old).max() > 1e-4
    if quasi_static:
        np.testing.assert_allclose(old, new, atol=1e-3 * np.abs(new).max())

    # It is not lost: with enough iterations it arrives.
    assert solver.step(state, target).converged.all()


@pytest.mark.parametrize(
    ("law", "ends"),
    [
        ("stable_neo_hookean", EnvStatus.BLOCKED),
        ("st_venant_kirchhoff", EnvStatus.INVERSION),
    ],
)
def test_a_body_does_not_leave_through_the_glued_back(law: str, ends: EnvStatus) -> None:
    """These energies bear inversion: one still pushes back until the box is at the glued face,
    where no way goes on, the other lets tets turn inside out before."""
    gel = SoftBody(
        block_mesh((3, 3, 1), (4e-3, 4e-3, 1e-3)),
        Material(1e5, 0.4, model=MaterialModel(law)),
        element=Element.LINEAR,
    )
    box = KinematicBody(box_mesh((1e-3, 1e-3, 1e-3)), name="box")
    model = Scene(gel, box).finalize()
    solver = SolverIPC(model, SolverConfig(max_substep_halvings=1))
    state = initial_state(model, pose(0, 0, 5.5e-4)[None, None])
    statuses = []
    for z in np.linspace(5e-4, -2.2e-3, 10):
        before = state.positions.numpy().copy()
        report = solver.step(state, pose(0, 0, z)[None, None])
        statuses.append(report.status[0])
        assert find_intersections(model, state)[0] == []
        if not report.converged[0]:
            np.testing.assert_array_equal(state.positions.numpy(), before)
            break
    assert statuses[0] == EnvStatus.CONVERGED
    assert statuses[-1] == ends
