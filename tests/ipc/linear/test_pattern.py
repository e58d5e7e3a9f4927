# SPDX-License-Identifier: Apache-2.0
"""The block pattern against a dense assembly of the element blocks of groups of any width."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.model.matrix_pattern import (
    BlockGather,
    BlockPattern,
    block_gather,
    block_pattern,
    node_gather,
    pair_nodes,
)

NODE_COUNT, FREE_COUNT = 14, 9


def random_groups(seed: int) -> tuple[np.random.Generator, list[np.ndarray], np.ndarray]:
    """Elements of four, ten and eight nodes, and the rows of the nodes."""
    rng = np.random.default_rng(seed)
    groups = [
        np.stack([rng.permutation(NODE_COUNT)[:width] for _ in range(count)])
        for width, count in ((4, 12), (10, 3), (8, 2))
    ]
    free_index = np.full(NODE_COUNT, -1)
    free_index[rng.permutation(NODE_COUNT)[:FREE_COUNT]] = rng.permutation(FREE_COUNT)
    return rng, groups, free_index


def random_elements(rng: np.random.Generator, group: np.ndarray) -> np.ndarray:
    """Symmetric element matrices, shape [element, n, 3, n, 3]."""
    count, width = group.shape
    elements = rng.normal(size=(count, width, 3, width, 3))
    return elements + elements.transpose(0, 3, 4, 1, 2)


def element_block(stored: np.ndarray, code: int) -> np.ndarray:
    """The block that a source code means; ``stored``: [part, 3, 3]."""
    part = stored[code // 2]
    return part.T if code % 2 else part


def stored_blocks(elements: np.ndarray) -> np.ndarray:
    """One part an element block, in the order of ``pair_nodes``."""
    first, second = np.triu_indices(elements.shape[1])
    return elements[:, first, :, second].swapaxes(0, 1).reshape(-1, 3, 3)


def gathers_of(
    groups: list[np.ndarray], free_index: np.ndarray, moving: np.ndarray | None = None
) -> tuple[BlockPattern, list[BlockGather]]:
    pattern = block_pattern(groups, free_index)
    return pattern, [block_gather(pattern, *pair_nodes(g), free_index, moving) for g in groups]


@pytest.mark.parametrize("seed", range(4))
def test_gathered_blocks_equal_dense_assembly(seed: int) -> None:
    rng, groups, free_index = random_groups(seed)
    pattern, gathers = gathers_of(groups, free_index)
    expected = np.zeros((FREE_COUNT, 3, FREE_COUNT, 3))
    values = np.zeros((1, pattern.block_count, 3, 3))
    for group, gather in zip(groups, gathers, strict=True):
        elements = random_elements(rng, group)
        for nodes, element in zip(group, elements, strict=True):
            rows = free_index[nodes]
            free = np.flatnonzero(rows >= 0)
            for i in free:
                for j in free:
                    expected[rows[i], :, rows[j]] += element[i, :, j]
        stored = stored_blocks(elements)
        for block, first, end in zip(
            gather.blocks, gather.source_starts[:-1], gather.source_starts[1:], strict=True
        ):
            assert end > first, "a block without sources"
            for code in gather.sources[first:end]:
                values[0, block] += element_block(stored, code)
        assert len(gather.rim_rows) == 0

    assert (pattern.columns <= pattern.rows).all()
    np.testing.assert_array_equal(pattern.columns[pattern.diagonal], np.arange(FREE_COUNT))
    np.testing.assert_array_equal(pattern.diagonal, pattern.row_starts[1:] - 1)
    n = 3 * FREE_COUNT
    np.testing.assert_allclose(pattern.dense(values)[0], expected.reshape(n, n), atol=1e-13)


@pytest.mark.parametrize("seed", range(2))
def test_rim_is_the_coupling_with_moving_prescribed_nodes(seed: int) -> None:
    rng, groups, free_index = random_groups(seed)
    prescribed = np.flatnonzero(free_index < 0)
    moving = np.zeros(NODE_COUNT, dtype=bool)
    moving[prescribed[:3]] = True
    motion = rng.normal(size=(NODE_COUNT, 3))
    _, gathers = gathers_of(groups, free_index, moving)
    found, expected = np.zeros((2, FREE_COUNT, 3))
    for group, gather in zip(groups, gathers, strict=True):
        elements = random_elements(rng, group)
        for nodes, element in zip(group, elements, strict=True):
            for i, j in np.ndindex(len(nodes), len(nodes)):
                if free_index[nodes[i]] >= 0 and moving[nodes[j]]:
                    expected[free_index[nodes[i]]] += element[i, :, j] @ motion[nodes[j]]
        stored = stored_blocks(elements)
        for k, row in enumerate(gather.rim_rows):
            for e in range(gather.rim_starts[k], gather.rim_starts[k + 1]):
                block = element_block(stored, gather.rim_sources[e])
                found[row] += block @ motion[gather.rim_nodes[e]]
    assert np.abs(expected).max() > 1
    np.testing.assert_allclose(found, expected, atol=1e-13)


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
