# SPDX-License-Identifier: Apache-2.0
"""Systems with a correction that is not symmetric, against a dense solve."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.corrected import MOST_SOLVES, TOLERANCE, CorrectedSolve
from taccel_lab.ipc.linear.system import LinearSystem
from tests.ipc.linear.systems import delaunay_pattern, mask, random_spd, residuals, solve

ENVS = 4
STILL = 3
"""The environment that takes no part."""


class Corrected:
    """Spring networks whose last rows push on others, and not the other way round."""

    def __init__(self, size: float, broken: int | None = None) -> None:
        rng = np.random.default_rng(5)
        pattern = delaunay_pattern(rng, 40, bonded=4)
        self.system = LinearSystem(pattern, ENVS, wp.get_device("cpu"))
        values = np.stack([random_spd(rng, pattern, 30.0) for _ in range(ENVS)])
        if broken is not None:
            values[broken] *= -1.0
        self.system.values.assign(values)
        self.dense = pattern.dense(values)
        n = 3 * pattern.free_count
        left, right = rng.normal(size=(2, ENVS, n, 3))
        self.corrections = size * left @ right.swapaxes(1, 2)
        self.rhs = rng.normal(size=(ENVS, pattern.free_count, 3))
        self.system.rhs.assign(self.rhs)
        self.solve = CorrectedSolve(self.system)
        self.who = mask(*(int(env != STILL) for env in range(ENVS)))
        self.asked = 0

    def change(self, mask: wp.array) -> None:
        self.asked += 1
        z = self.system.solution.numpy().reshape(ENVS, -1)
        product = np.einsum("eij,ej->ei", self.corrections, z).reshape(self.rhs.shape)
        changes = self.solve.changes.numpy()
        changes[mask.numpy() != 0] = product[mask.numpy() != 0]
        self.solve.changes.assign(changes)

    def run(self) -> np.ndarray:
        """Residual over load of each environment."""
        solve(self.system, 1e-8, most=2000)
        self.plain = self.system.solution.numpy().copy()
        totals = wp.zeros(ENVS, dtype=wp.int32)
        self.solve.solve(self.who, self.change, 2000, totals)
        self.totals = totals.numpy()
        return residuals(self.system, self.dense + self.corrections, self.rhs)


def test_a_correction_of_rank_three_is_solved_in_four() -> None:
    case = Corrected(4.0)
    left = case.run()
    alone = case.plain.reshape(ENVS, -1)
    load = case.rhs.reshape(ENVS, -1)
    before = np.einsum("eij,ej->ei", case.corrections, alone)
    assert (np.linalg.norm(before, axis=1) > 0.8 * np.linalg.norm(load, axis=1)).all()
    assert (left[:STILL] <= 1.001 * TOLERANCE).all(), left
    assert case.asked <= 4 < MOST_SOLVES
    assert (case.totals[:STILL] > 0).all() and case.totals[STILL] == 0


def test_without_a_correction_the_solution_stays() -> None:
    case = Corrected(0.0)
    case.run()
    assert case.asked == 1
    found = case.system.solution.numpy()[:STILL]
    np.testing.assert_allclose(found, case.plain[:STILL], rtol=1e-6, atol=1e-9)


def test_a_breakdown_ends_the_environment_where_it_happens() -> None:
    case = Corrected(4.0, broken=1)
    left = case.run()
    assert case.system.breakdown.numpy()[1] != 0 or left[1] == 1.0
    assert np.isfinite(case.system.solution.numpy()[:STILL]).all()
    assert (left[[0, 2]] <= 1.001 * TOLERANCE).all()
