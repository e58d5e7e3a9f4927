# SPDX-License-Identifier: Apache-2.0
"""Captured steps: the same bits as launches one by one, whatever becomes of the arrays."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state

STEPS = 6


def cube_on_a_gel(env_count: int = 2) -> Scene:
    """A gel on a mount under a free cube."""
    gel = SoftBody(
        block_mesh((4, 4, 2), (6e-3, 6e-3, 3e-3)),
        Material(1e5, 0.4),
        mount="hand",
        friction_coefficient=0.5,
        element=Element.LINEAR,
    )
    cube = AffineBody(
        box_mesh((3e-3, 3e-3, 3e-3)),
        name="cube",
        friction_coefficient=0.5,
        initial_pose=np.array([0.2e-3, 0, 1.58e-3, 0, 0, 0, 1.0]),
    )
    time = TimeStepping(quasi_static=False, dt_s=2e-3, gravity_m_s2=(0.0, 0.0, -9.81))
    hand = KinematicBody(None, name="hand")
    return Scene([gel], [hand], env_count, time, affine_bodies=[cube])


def poses(step: int, env_count: int = 2) -> np.ndarray:
    """The mount goes sideways and turns, each environment at its own pace."""
    pace = 1 + np.arange(env_count)
    angle = 4e-3 * step * pace
    zero = np.zeros(env_count)
    columns = [1e-4 * step * pace, zero, zero, zero, zero, np.sin(angle / 2), np.cos(angle / 2)]
    return np.stack(columns, axis=1)[:, None]


def make(**options: object) -> tuple[SolverIPC, State]:
    model = cube_on_a_gel().finalize()
    config = SolverConfig(dhat_m=1e-4, **options)  # type: ignore[arg-type]
    return SolverIPC(model, config), initial_state(model, poses(0))


def run(solver: SolverIPC, state: State, on_device: bool = False) -> np.ndarray:
    for step in range(1, STEPS):
        target = poses(step)
        report = solver.step(
            state, wp.array(target, dtype=wp.transformd, device="cpu") if on_device else target
        )
        assert report.converged.all(), report.summary()
    return np.concatenate(
        [a.numpy().ravel() for a in (state.positions, state.velocities, solver.contact_gradient)]
    )


@pytest.fixture(scope="module")
def eager() -> np.ndarray:
    solver, state = make(capture=False)
    result = run(solver, state)
    assert solver.graph.launches == 0
    return result


def test_a_captured_run_is_bitwise_the_same(eager: np.ndarray) -> None:
    solver, state = make()
    np.testing.assert_array_equal(run(solver, state), eager)
    # The first step comes as it is.
    assert solver.graph.launches == STEPS - 2


def gel_on_gel() -> Scene:
    """A gel on a mount above another one, out of reach."""
    mesh = block_mesh((3, 3, 2), (5e-3, 5e-3, 3e-3))
    lower = SoftBody(
        mesh, Material(1e5, 0.4), name="lower", friction_coefficient=0.5, element=Element.LINEAR
    )
    upper = SoftBody(
        mesh,
        Material(5e4, 0.4),
        name="upper",
        mount="hand",
        friction_coefficient=0.5,
        element=Element.LINEAR,
    )
    return Scene([lower, upper], [KinematicBody(None, name="hand")])


@pytest.mark.parametrize("first_contact", [1, 5])
def test_trees_of_soft_bodies_are_refitted_in_a_graph(first_contact: int) -> None:
    """Also where the graph is recorded while they are out of reach, and searches no tree."""
    heights = np.concatenate([np.linspace(1e-3, 2e-4, first_contact), -1e-4 * np.arange(1, 7)])
    ends = []
    for capture in (False, True):
        model = gel_on_gel().finalize()
        solver = SolverIPC(model, SolverConfig(dhat_m=5e-5, capture=capture))
        targets = [
            np.array([[[3e-4 + 1e-4 * k, 2e-4, z, 1.0, 0, 0, 0]]]) for k, z in enumerate(heights)
        ]
        state = initial_state(model, targets[0])
        forces = []
        for target in targets[1:]:
            report = solver.step(state, target)
            assert report.converged.all(), report.summary()
            forces.append(report.contact_force_n[0])
        assert (np.array(forces[: first_contact - 1]) == 0).all() and min(forces[-6:]) > 0
        assert solver.graph.launches == (len(targets) - 2 if capture else 0)
        ends.append(state.positions.numpy())
    np.testing.assert_array_equal(*ends)


def test_targets_may_be_on_the_device(eager: np.ndarray) -> None:
    solver, state = make()
    np.testing.assert_array_equal(run(solver, state, on_device=True), eager)
    with pytest.raises(InputError, match=r"of shape \[2, 2\]; expected float64 of shape"):
        solver.step(state, wp.zeros((2, 2), dtype=wp.transformd, device="cpu"))


def test_targets_and_starts_may_be_tensors(eager: np.ndarray) -> None:
    """Without a copy: torch's memory is read where it is."""
    torch = pytest.importorskip("torch")
    solver, state = make()
    for step in range(1, STEPS):
        assert solver.step(state, torch.from_numpy(poses(step))).converged.all()
    found = np.concatenate([state.positions.numpy().ravel(), state.velocities.numpy().ravel()])
    np.testing.assert_array_equal(found, eager[: len(found)])
    everyone = np.ones(solver.model.env_count, dtype=bool)
    solver.reset(state, everyone, torch.from_numpy(poses(0)))
    fresh = initial_state(solver.model, poses(0))
    np.testing.assert_array_equal(state.positions.numpy(), fresh.positions.numpy())
    with pytest.raises(InputError, match="expected float64 of shape"):
        solver.step(state, torch.from_numpy(poses(1)).float())


def test_states_have_graphs_of_their_own(eager: np.ndarray) -> None:
    solver, first = make()
    second = initial_state(solver.model, poses(0))
    for step in range(1, STEPS):
        for state in (first, second):
            assert solver.step(state, poses(step)).converged.all()
    for state in (first, second):
        found = np.concatenate([state.positions.numpy().ravel(), state.velocities.numpy().ravel()])
        np.testing.assert_array_equal(found, eager[: len(found)])


def test_lists_that_were_too_short_grow_and_the_step_is_taken_again(eager: np.ndarray) -> None:
    solver, state = make()
    for part in solver.lists:
        part._allocate(2)
    np.testing.assert_array_equal(run(solver, state), eager)
    assert all((part.rooms > 2).any() for part in solver.lists)


def test_lists_that_others_grew_are_not_written_through_old_graphs(eager: np.ndarray) -> None:
    solver, state = make()
    for step in range(1, STEPS):
        assert solver.step(state, poses(step)).converged.all()
        for part in solver.lists:
            part._allocate(part.rooms + 7)
    np.testing.assert_array_equal(
        state.positions.numpy().ravel(), eager[: state.positions.size * 3]
    )


def test_contacts_beyond_the_limit_are_given_up_in_their_environment() -> None:
    solver, state = make(max_collisions=4)
    before = state.positions.numpy().copy()
    report = solver.step(state, poses(1))
    assert (report.status == EnvStatus.CONTACT_OVERFLOW).all()
    np.testing.assert_array_equal(state.positions.numpy(), before)


def test_the_plan_says_why_steps_are_not_captured() -> None:
    assert make()[0].plan.is_on("captured graph")
    solver, _ = make(capture=False)
    assert not solver.plan.is_on("captured graph")
    assert "SolverConfig.capture" in solver.plan.describe()
