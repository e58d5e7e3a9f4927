# SPDX-License-Identifier: Apache-2.0
"""Solves with the exact matrix of a state: right where it is stable, named where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.ipc.potentials.contact_derivatives import ContactDerivatives
from taccel_lab.scene import Ball, KinematicBody, Material, Scene, TimeStepping
from taccel_lab.solvers.tangent import INDEFINITE, Tangent, sparse_matrix
from tests.solvers.steps import begun
from tests.support.blocks import everywhere, pose, soft_block

BAR = soft_block((2, 1, 8), (1.6e-3, 1e-3, 9e-3), Material(1e5, 0.3))

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
    made = Scene(BAR, KinematicBody(Ball(1e-3))).finalize("cpu")
    solver, state = begun(made, everywhere(1, pose(0, 0, 0.1)))
    x, height = state.positions.numpy().copy(), BAR.mesh.nodes_m[:, 2]
    x[0, : len(height), 2] = height.min() + (1 - by) * (height - height.min())
    state.positions.assign(x)
    tangent = Tangent(solver, state)
    tangent.add_elements()
    values, pattern = solver.linear.values.numpy(), solver.model.pattern
    dense = pattern.dense(values)[0]
    both = sparse_matrix(pattern, values[0]).toarray()
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


def test_a_bar_about_to_buckle_and_a_singular_matrix_are_named() -> None:
    tangent, dense = squeezed(0.02)
    assert np.linalg.eigvalsh(dense).min() < 0
    rhs = np.random.default_rng(0).normal(size=(1, len(dense) // 3, 3))
    assert tangent.solve(rhs).causes == [INDEFINITE]
    tangent.solver.linear.values.zero_()
    (cause,) = tangent.solve_transposed(rhs, NO_CONTACT).causes
    assert cause is not None and "singular" in cause


def test_scenes_with_inertia_are_refused() -> None:
    made = begun(Scene(BAR, time=TimeStepping(quasi_static=False)).finalize("cpu"))
    with pytest.raises(InputError, match="quasi-static steps of elastic gels"):
        Tangent(*made)
