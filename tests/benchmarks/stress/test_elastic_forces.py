# SPDX-License-Identifier: Apache-2.0
"""The stress's own forces against those of the solver: two codes, one formula."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.benchmarks.stress.balance import ForceBalance, Snapshot
from taccel_lab.benchmarks.stress.shapes import pose, soft_box, stiff_shape
from taccel_lab.scene import (
    AffineBody,
    Element,
    Material,
    MaterialModel,
    Scene,
    SoftBody,
    TimeScheme,
    TimeStepping,
)
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state


def made(
    law: MaterialModel, element: Element = Element.QUADRATIC
) -> tuple[SolverIPC, State, ForceBalance]:
    """The solver's forces of a block, and the stress's."""
    ratio = 0.2 if law is MaterialModel.MOONEY_RIVLIN else 0.0
    box, free = soft_box((2, 2, 2), (3e-3, 3e-3, 3e-3), 0.2, 1), np.zeros(0, dtype=np.int64)
    body = SoftBody(box, Material(1e5, 0.42, 1000.0, law, ratio), free, element=element)
    model = Scene(body, time=TimeStepping(quasi_static=False)).finalize()
    return SolverIPC(model), initial_state(model), ForceBalance(model, SolverConfig())


def require_equal(solver: SolverIPC, balance: ForceBalance, moved: np.ndarray) -> None:
    mine = balance.soft[0][0].elastic_gradient(moved)
    positions = wp.array(moved[None], dtype=wp.vec3d)
    theirs = wp.zeros_like(positions)
    solver.potentials["elastic"].add_gradient(wp.full(1, 1, dtype=wp.int32), positions, theirs)
    np.testing.assert_allclose(theirs.numpy()[0], mine, atol=1e-10 * np.abs(mine).max())
    assert np.abs(mine).max() > 1e-3


@pytest.mark.parametrize("element", Element)
@pytest.mark.parametrize("law", MaterialModel)
def test_elastic_forces_are_the_solvers(law: MaterialModel, element: Element) -> None:
    """Of nodes moved smoothly, by strains of some tens of per cent."""
    solver, state, balance = made(law, element)
    x, y, z = state.positions.numpy()[0].T
    bend = np.stack([np.sin(500 * y), np.cos(400 * z) * 0.5, np.sin(300 * x + 1)], axis=1)
    moved = np.stack([x, y, z], axis=1) + 0.3 * 2e-3 * bend
    assert balance.volume_ratios(0, moved)[0][1].min() > 0
    require_equal(solver, balance, moved)


@pytest.mark.parametrize("law", [MaterialModel.NEO_HOOKEAN, MaterialModel.MOONEY_RIVLIN])
def test_guards_are_the_solvers(law: MaterialModel) -> None:
    solver, state, balance = made(law)
    rest, rng, guarded = state.positions.numpy()[0], np.random.default_rng(0), 0
    for size in np.linspace(2e-5, 1.2e-4, 120):
        moved = rest + rng.normal(0, size, rest.shape)
        ratios = balance.volume_ratios(0, moved)[0][1]
        if ratios.min() < 0.01:
            continue
        guarded += (ratios < 0.2).sum()
        require_equal(solver, balance, moved)
    assert guarded > 10


@pytest.mark.parametrize("element", Element)
@pytest.mark.parametrize("scheme", ["quasi-static", *TimeScheme])
def test_the_residual_of_a_converged_step_and_of_a_wrong_one(scheme: str, element: Element) -> None:
    mesh = soft_box((3, 2, 2), (4e-3, 2e-3, 2e-3), 0.2, 2)
    held = np.flatnonzero(mesh.nodes_m[:, 0] < -2e-3 + 1e-9)
    body = SoftBody(mesh, Material(1e5, 0.45), held, element=element)
    dynamic, bdf2 = scheme != "quasi-static", scheme == TimeScheme.BDF2
    order = TimeScheme.BDF2 if bdf2 else TimeScheme.EULER
    stiff = AffineBody(
        stiff_shape("needle", 2e-3), name="stiff", initial_pose=pose((0, 0, 8e-3)),
        initial_velocity_m_s=(0.1, 0, 0.3), initial_spin_rad_s=(50.0, 20.0, 0.0),
    )  # fmt: skip
    time = TimeStepping(not dynamic, 2e-3, scheme=order)
    model = Scene(body, affine_bodies=[stiff] * dynamic, time=time).finalize()
    solver, state = SolverIPC(model), initial_state(model)
    balance = ForceBalance(model, solver.config)
    forces = np.zeros((1, model.node_count, 3))
    forces[0, : model.soft_count, 2] = 1e-4
    state.load(model, forces)
    none = np.zeros((model.node_count, 3))
    for _ in range(3):
        before = Snapshot.of(state)
        assert solver.step(state).converged.all()
        now = Snapshot.of(state)
        left, allowed = balance.residual(0, before, now, none, none, forces[0])
        assert left < 1.01 * allowed and allowed < 1.5e-7
        # A hundredth of a micrometre off, at one node: the referee can fail.
        wrong = now.positions.copy()
        wrong[0, model.free_nodes.numpy()[0]] += 1e-8
        off = Snapshot(wrong, now.velocities, now.poses, now.history)
        assert balance.residual(0, before, off, none, none, forces[0])[0] > 1e-6
