# SPDX-License-Identifier: Apache-2.0
"""Patterns of elements, their gathers, and an order of elimination; blocks found in a pattern.

What elements add up to is compared with differences in ``potentials``, what is factorised with
direct solves.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.ipc.linear.arrow.program import least_degree_order
from taccel_lab.ipc.linear.problem.scatter import find_block
from taccel_lab.model.matrix_pattern import block_pattern, node_gather


def test_a_node_in_no_element_has_its_diagonal() -> None:
    pattern = block_pattern([np.array([[0, 1]])], np.arange(3))
    np.testing.assert_array_equal(pattern.rows, [0, 1, 1, 2])
    np.testing.assert_array_equal(pattern.columns, [0, 0, 1, 2])


def test_a_node_twice_in_an_element_of_controls() -> None:
    """A body without partner is listed as a pair with itself: its couplings, no others."""
    pattern = block_pattern([np.array([[0, 1, 0, 1]])], np.arange(3))
    np.testing.assert_array_equal(pattern.columns, [0, 0, 1, 2])


def test_nodes_gather_all_their_elements() -> None:
    elements = np.array([[7, 3, 5], [3, 9, 7]])
    nodes, starts, entries = node_gather(elements)
    np.testing.assert_array_equal(nodes, [3, 5, 7, 9])
    for node, first, end in zip(nodes, starts[:-1], starts[1:], strict=True):
        np.testing.assert_array_equal(
            np.sort(entries[first:end]), np.flatnonzero(elements.ravel() == node)
        )


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


@wp.kernel(enable_backward=False)
def _find_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    found: wp.array2d(dtype=wp.int32),
):
    row, column = wp.tid()
    if column <= row:
        found[row, column] = find_block(row, column, row_starts, columns)


@given(seed=st.integers(0, 10_000), size=st.integers(1, 12), density=st.floats(0, 1))
def test_every_block_is_found_and_no_other(seed: int, size: int, density: float) -> None:
    """Rows of any pattern end with their diagonal block."""
    held = np.tril(np.random.default_rng(seed).random((size, size)) < density)
    held[np.diag_indices(size)] = True
    rows, columns = np.nonzero(held)
    starts = np.searchsorted(rows, np.arange(size + 1))
    found = wp.full((size, size), -7, dtype=wp.int32, device="cpu")
    wp.launch(
        _find_kernel,
        dim=(size, size),
        inputs=[wp.array(a, dtype=wp.int32, device="cpu") for a in (starts, columns)],
        outputs=[found],
        device="cpu",
    )
    expected = np.where(np.tril(np.ones_like(held)), -1, -7)
    expected[rows, columns] = np.arange(len(rows))
    np.testing.assert_array_equal(found.numpy(), expected)
