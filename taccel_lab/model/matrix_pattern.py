# SPDX-License-Identifier: Apache-2.0
"""The fixed sparsity pattern of the Newton matrix: 3x3 blocks between free nodes of one element.

An element is any set of nodes that are all coupled with each other: the four or ten nodes of a tet,
the four control nodes of an affine body, the eight of a joint. The pattern is computed once per
scene and shared by all environments; only the values are per environment, shape
[env_count, block_count]. The matrix is symmetric: its lower triangle is stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


def element_pairs(node_count: int) -> list[tuple[int, int]]:
    """Pairs (i, j), i <= j, of local nodes, in the order in which element blocks are stored."""
    return [(i, j) for i in range(node_count) for j in range(i, node_count)]


@dataclass(frozen=True)
class BlockPattern:
    """Block-CSR pattern of the lower triangle."""

    row_starts: np.ndarray
    """int32, shape [free_count + 1]."""
    columns: np.ndarray
    """Free-node columns, ascending within a row and ending at the diagonal, int32,
    shape [block_count]."""
    diagonal: np.ndarray
    """Index of each row's diagonal block, int32, shape [free_count]."""

    @property
    def free_count(self) -> int:
        """Rows of the matrix."""
        return len(self.row_starts) - 1

    @property
    def block_count(self) -> int:
        """Stored blocks of one environment."""
        return len(self.columns)

    @property
    def rows(self) -> np.ndarray:
        """Row of each stored block, int32, shape [block_count]."""
        return np.repeat(np.arange(self.free_count, dtype=np.int32), np.diff(self.row_starts))

    def dense(self, values: np.ndarray) -> np.ndarray:
        """Full symmetric matrices of the stored blocks, both triangles.

        ``values``: shape [env_count, block_count, 3, 3]. Returns shape
        [env_count, 3 free_count, 3 free_count].
        """
        n = self.free_count
        full = np.zeros((len(values), n, n, 3, 3))
        full[:, self.columns, self.rows] = np.swapaxes(values, -1, -2)
        full[:, self.rows, self.columns] = values
        return full.transpose(0, 1, 3, 2, 4).reshape(len(values), 3 * n, 3 * n)


@dataclass(frozen=True)
class BlockGather:
    """Which element blocks of one group add up in which block of the matrix, in a fixed order."""

    blocks: np.ndarray
    """Entries of the pattern that the group touches, ascending, int32, shape [touched]."""
    source_starts: np.ndarray
    """Range of each of them in ``sources``, int32, shape [touched + 1]."""
    sources: np.ndarray
    """Element blocks as 2 (pair_count element + pair) + transposed, int32."""
    rim_rows: np.ndarray
    """Rows whose right-hand side feels prescribed nodes that move, ascending, int32."""
    rim_starts: np.ndarray
    """Range of each of them in the next two, int32, shape [rim + 1]."""
    rim_sources: np.ndarray
    """Element blocks d^2E / dx_row dx_node, coded like ``sources``, int32."""
    rim_nodes: np.ndarray
    """The prescribed nodes, int32."""


def block_pattern(
    groups: Sequence[np.ndarray], free_index: np.ndarray, moving_nodes: np.ndarray | None = None
) -> tuple[BlockPattern, list[BlockGather]]:
    """Pattern of elements that couple all their nodes, and what each group of them adds to it.

    ``groups``: node indices, int, shape [element, nodes_per_element] each. ``free_index``: row of
    each node or -1 when it is prescribed, shape [node_count]. ``moving_nodes``: prescribed nodes
    that do move (a gel on a mount), bool, shape [node_count]; none when left out. Every row has its
    diagonal block, also that of a node in no element.
    """
    free_index = np.asarray(free_index, dtype=np.int64)
    free_count = int((free_index >= 0).sum())
    moving = np.zeros(len(free_index), dtype=bool) if moving_nodes is None else moving_nodes
    entries = [_matrix_entries(np.asarray(e, dtype=np.int64), free_index) for e in groups]
    diagonal_keys = np.arange(free_count, dtype=np.int64) * (free_count + 1)
    keys = np.unique(np.concatenate([diagonal_keys, *(key for key, _ in entries)]))
    rows, columns = np.divmod(keys, max(free_count, 1))
    pattern = BlockPattern(
        row_starts=np.searchsorted(rows, np.arange(free_count + 1)).astype(np.int32),
        columns=columns.astype(np.int32),
        diagonal=np.flatnonzero(rows == columns).astype(np.int32),
    )
    gathers = []
    for elements, (key, code) in zip(groups, entries, strict=True):
        blocks, starts, order = _sorted_ranges(key, code)
        rim_row, rim_code, rim_node = _rim_entries(np.asarray(elements), free_index, moving)
        rim_rows, rim_starts, rim_order = _sorted_ranges(rim_row, rim_code)
        gathers.append(
            BlockGather(
                blocks=np.searchsorted(keys, blocks).astype(np.int32),
                source_starts=starts,
                sources=code[order].astype(np.int32),
                rim_rows=rim_rows.astype(np.int32),
                rim_starts=rim_starts,
                rim_sources=rim_code[rim_order].astype(np.int32),
                rim_nodes=rim_node[rim_order].astype(np.int32),
            )
        )
    return pattern, gathers


def node_gather(elements: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of a group, the start of each in the entries, and entries
    nodes_per_element * element + local; all int32, in a fixed order."""
    flat = np.asarray(elements, dtype=np.int64).ravel()
    nodes, starts, order = _sorted_ranges(flat, np.arange(len(flat)))
    return nodes.astype(np.int32), starts, order.astype(np.int32)


def _sorted_ranges(key: np.ndarray, code: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unique keys, the start of each in the sorted entries, and the order that sorts them."""
    order = np.lexsort((code, key))
    unique, starts = np.unique(key[order], return_index=True)
    return unique, np.append(starts, len(key)).astype(np.int32), order


def _matrix_entries(elements: np.ndarray, free_index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Key row * free_count + column in the lower triangle, and code, of each element block."""
    free_count = int((free_index >= 0).sum())
    pairs = element_pairs(elements.shape[1])
    ids = len(pairs) * np.arange(len(elements), dtype=np.int64)
    keys, codes = [], []
    for pair, (i, j) in enumerate(pairs):
        first, second = free_index[elements[:, i]], free_index[elements[:, j]]
        keep = (first >= 0) & (second >= 0)
        key = np.maximum(first, second) * free_count + np.minimum(first, second)
        keys.append(key[keep])
        codes.append((2 * (ids + pair) + (first < second))[keep])
    return np.concatenate(keys), np.concatenate(codes)


def _rim_entries(
    elements: np.ndarray, free_index: np.ndarray, moving: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, code and prescribed node of each block between a free and a moving prescribed node."""
    touched = np.flatnonzero(moving[elements].any(axis=1))
    if not len(touched):
        none = np.zeros(0, dtype=np.int64)
        return none, none, none
    pairs = element_pairs(elements.shape[1])
    rows, codes, nodes = [], [], []
    for pair, (i, j) in enumerate(pairs):
        for own, other, transposed in ((i, j, 0), (j, i, 1)):
            row, node = free_index[elements[touched, own]], elements[touched, other]
            keep = (row >= 0) & (free_index[node] < 0) & moving[node]
            rows.append(row[keep])
            nodes.append(node[keep])
            codes.append((2 * (len(pairs) * touched + pair) + transposed)[keep])
    return np.concatenate(rows), np.concatenate(codes), np.concatenate(nodes)
