# SPDX-License-Identifier: Apache-2.0
"""Symbolic block-arrow factorisation against dense Cholesky."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.ipc.linear.elimination import eliminate, least_degree_order
from tests.ipc.linear.systems import delaunay_pattern, random_spd


@given(st.integers(0, 2**32 - 1), st.integers(8, 40), st.integers(0, 5))
@settings(max_examples=15)
def test_numbered_blocks_give_the_cholesky_factor(seed: int, nodes: int, borders: int) -> None:
    rng = np.random.default_rng(seed)
    pattern = delaunay_pattern(rng, nodes, 2)
    n = pattern.free_count
    border = np.sort(rng.permutation(n)[: min(borders, n - 1)])
    plan = eliminate(pattern, border)
    values = random_spd(rng, pattern, 10.0)
    np.testing.assert_array_equal(plan.border, border)
    np.testing.assert_array_equal(np.sort(np.append(plan.order, border)), np.arange(n))

    blocks = np.zeros((plan.block_count, 3, 3))
    for block, code in enumerate(plan.codes):
        if code >= 0:
            blocks[block] = values[code // 2].T if code % 2 else values[code // 2]
    ends = np.append(plan.starts[1:], plan.block_count)
    for level, (first, end) in enumerate(
        zip(plan.level_starts[:-1], plan.level_starts[1:], strict=True)
    ):
        for block in range(first, end):
            own = plan.pairs[plan.pair_starts[block] : plan.pair_starts[block + 1]]
            # A level needs nothing but the levels before.
            assert (own < first).all()
            for a, b in own:
                blocks[block] -= blocks[a] @ blocks[b].T
        for column in range(plan.level_columns[level], plan.level_columns[level + 1]):
            start = plan.starts[column]
            blocks[start] = np.linalg.cholesky(blocks[start])
            below = blocks[start + 1 : ends[column]]
            below[:] = below @ np.linalg.inv(blocks[start]).T
    order = np.append(plan.order, border)
    dofs = (3 * order[:, None] + np.arange(3)).ravel()
    expected = np.linalg.cholesky(pattern.dense(values[None])[0][np.ix_(dofs, dofs)])
    found = np.zeros_like(expected)
    count, m = len(plan.order), len(border)

    def put(row: int, column: int, block: int) -> None:
        found[3 * row : 3 * row + 3, 3 * column : 3 * column + 3] = blocks[block]

    for column in range(count):
        put(column, column, plan.starts[column])
        for c in range(m):
            put(count + c, column, plan.starts[column] + 1 + c)
    for block, row in plan.inner:
        put(row, plan.columns[block], block)
    found[3 * count :, 3 * count :] = expected[3 * count :, 3 * count :]
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_least_degree_takes_leaves_first() -> None:
    # A star and a chain: no order of a forest from its leaves fills anything in.
    edges = [(0, 1), (0, 2), (0, 3), (0, 4), (5, 6), (6, 7)]
    neighbours: list[set[int]] = [set() for _ in range(8)]
    for i, j in edges:
        neighbours[i].add(j)
        neighbours[j].add(i)
    order, left = least_degree_order(neighbours)
    assert sorted(order) == list(range(8))
    assert sum(len(rows) for rows in left) == len(edges)
