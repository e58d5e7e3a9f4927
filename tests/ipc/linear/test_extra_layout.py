# SPDX-License-Identifier: Apache-2.0
"""Row lists of extra blocks in order: the same bits however the blocks were listed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.linear.block_cg import BlockCG
from taccel_lab.ipc.linear.pipelined_cg import PipelinedCG
from taccel_lab.ipc.linear.system import METHODS, LinearSystem, Solver
from tests.ipc.linear.systems import contact_system, list_extra

CPU = wp.get_device("cpu")
LANES = 32
CONTACTS = 200
"""Each has eight blocks, in the columns of twenty nodes: more of a column than one lane adds up."""

SOLVERS: dict[str, Callable[[LinearSystem], Solver]] = {
    **METHODS,
    "cg, many lanes": lambda system: BlockCG(system, system.clusters, LANES),
    "pipelined, many lanes": lambda system: PipelinedCG(system, system.clusters, LANES),
}


def solve_listed(solver: str, seed: int, in_any_order: bool) -> np.ndarray:
    """Solutions of two environments whose blocks are listed in an order of the seed."""
    source, dense = contact_system(2, CONTACTS)
    system = LinearSystem(
        source.pattern, 2, CPU, source.clusters, method="cg", in_any_order=in_any_order
    )
    for name in ("values", "rhs"):
        wp.copy(getattr(system, name), getattr(source, name))
    rng = np.random.default_rng(seed)
    places, blocks = [], []
    for env in range(2):
        # Multiples of one number add up exactly, as those that an assembly lists do.
        listed = np.rint(source.extra.of(env, source.extra.values) * 2**24) / 2**24
        order = rng.permutation(len(listed))
        places.append(source.extra.of(env, source.extra.places)[order])
        blocks.append(listed[order])
    list_extra(system.extra, places, blocks)
    system._solver = SOLVERS[solver](system)
    system.tolerances.fill_(1e-8)
    system.solve(wp.full(2, 1, dtype=wp.int32, device=CPU), 1000)
    assert not system.report().breakdown.any()
    solutions = system.solution.numpy()
    for matrix, load, found in zip(dense, system.rhs.numpy(), solutions, strict=True):
        left = load.ravel() - matrix @ found.ravel()
        assert np.linalg.norm(left) <= 1e-6 * np.linalg.norm(load)
    return solutions


@pytest.mark.parametrize("solver", SOLVERS)
def test_bits_do_not_depend_on_the_order_of_the_list(many_lanes: None, solver: str) -> None:
    first, *others = (solve_listed(solver, seed, True) for seed in range(4))
    for other in others:
        np.testing.assert_array_equal(other, first)


def test_they_do_where_nobody_asks() -> None:
    first, *others = (solve_listed("cg", seed, False) for seed in range(4))
    assert any(not np.array_equal(other, first) for other in others)
