# SPDX-License-Identifier: Apache-2.0
"""Solves with the exact matrix of a state: right where it is stable, named where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.potentials.contact_derivatives import ContactDerivatives
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody, TimeStepping
from taccel_lab.solvers import SolverIPC
from taccel_lab.solvers.tangent import INDEFINITE, Tangent, sparse_matrix
from taccel_lab.state import initial_state

BAR = block_mesh((2, 1, 8), (1.6e-3, 1e-3, 9e-3))
AWAY = np.array([[[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]]])

NO_CONTACT = {
    0: ContactDerivatives(
        nodes=np.zeros((0, 4), dtype=np.int32),
        kinds=np.zeros(0, dtype=np.int32),
        stiffnesses=np.zeros(0),
        bodies=np.zeros((0, 2), dtype=np.int32),
        forces=np.zeros((0, 4, 3)),
        per_friction=np.zeros((0, 4, 3)),
        columns=np.zeros((0, 33, 4, 3)),
        kinks=np.zeros(0, dtype=bool),
    )
}


def squeezed(by: float) -> tuple[Tangent, np.ndarray]:
    """The tangent of a bar on its foot, shortened by a part, and its dense matrix."""
    gel = SoftBody(BAR, Material(1e5, 0.3), element=Element.LINEAR)
    model = Scene(gel, KinematicBody(Ball(1e-3))).finalize("cpu")
    state = initial_state(model, AWAY)
    x = state.positions.numpy().copy()
    foot = BAR.nodes_m[:, 2].min()
    x[0, : BAR.node_count, 2] = foot + (1 - by) * (BAR.nodes_m[:, 2] - foot)
    state.positions.assign(x)
    tangent = Tangent(SolverIPC(model), state)
    tangent.add_elements()
    values = tangent.solver.linear.values.numpy()
    dense = model.pattern.dense(values)[0]
    both = sparse_matrix(model.pattern, values[0]).toarray()
    np.testing.assert_allclose(both, dense, rtol=0, atol=1e-15 * np.abs(dense).max())
    return tangent, dense


def test_both_ways_of_solving_give_the_solution() -> None:
    tangent, dense = squeezed(0.0)
    assert np.linalg.eigvalsh(dense).min() > 0
    rhs = np.random.default_rng(0).normal(size=(1, len(dense) // 3, 3))
    expected = np.linalg.solve(dense, rhs.ravel())
    for solved in (tangent.solve(rhs), tangent.solve_transposed(rhs, NO_CONTACT)):
        assert solved.causes == [None]
        error = np.abs(solved.solution.ravel() - expected).max() / np.abs(expected).max()
        assert error < 1e-8


def test_a_bar_about_to_buckle_is_named() -> None:
    tangent, dense = squeezed(0.02)
    assert np.linalg.eigvalsh(dense).min() < 0
    rhs = np.random.default_rng(0).normal(size=(1, len(dense) // 3, 3))
    assert tangent.solve(rhs).causes == [INDEFINITE]


def test_a_singular_matrix_is_named() -> None:
    tangent, dense = squeezed(0.0)
    values = tangent.solver.linear.values.numpy()
    tangent.solver.linear.values.assign(np.zeros_like(values))
    (cause,) = tangent.solve_transposed(np.ones((1, len(dense) // 3, 3)), NO_CONTACT).causes
    assert cause is not None and "singular" in cause


def test_scenes_with_inertia_are_refused() -> None:
    gel = SoftBody(BAR, Material(1e5, 0.3))
    model = Scene(gel, time=TimeStepping(quasi_static=False)).finalize("cpu")
    with pytest.raises(InputError, match="quasi-static steps of elastic gels"):
        Tangent(SolverIPC(model), initial_state(model))
