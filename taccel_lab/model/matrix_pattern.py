# SPDX-License-Identifier: Apache-2.0
"""The fixed sparsity pattern of the Newton matrix: 3x3 blocks between free nodes of one element.

An element is any set of nodes that are all coupled with each other: the four or ten nodes of a tet,
the four control nodes of an affine body, the eight of a joint. The pattern is computed once per
scene and shared by all environments; only the values are per environment, shape
[env_count, block_count]. The matrix is symmetric: its lower triangle is stored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp


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
    """Which parts of one group of elements add up in which block of the matrix, in a fixed order.

    A part is d^2E / dx_first dx_second of some of its elements: one, or all of a chunk. Arrays are
    the host's or, ``on`` it, a device's.
    """

    blocks: Any
    """Entries of the pattern that the group touches, ascending, int32, shape [touched]."""
    source_starts: Any
    """Range of each of them in ``sources``, int32, shape [touched + 1]."""
    sources: Any
    """Parts as 2 part + transposed, int32."""
    rim_rows: Any
    """Rows whose right-hand side feels prescribed nodes that move, ascending, int32."""
    rim_starts: Any
    """Range of each of them in the next two, int32, shape [rim + 1]."""
    rim_sources: Any
    """Parts d^2E / dx_row dx_node, coded like ``sources``, int32."""
    rim_nodes: Any
    """The prescribed nodes, int32."""

    def on(self, put: Callable[[np.ndarray, Any], Any]) -> BlockGather:
        """The same with arrays that ``put`` has copied to a device."""
        return BlockGather(**{name: put(value, wp.int32) for name, value in vars(self).items()})


def block_pattern(groups: Sequence[np.ndarray], free_index: np.ndarray) -> BlockPattern:
    """Pattern of elements that couple all their nodes.

    ``groups``: node indices, int, shape [element, nodes_per_element] each. ``free_index``: row of
    each node or -1 when it is prescribed, shape [node_count]. Every row has its diagonal block,
    also that of a node in no element.
    """
    free_index = np.asarray(free_index, dtype=np.int64)
    free_count = int((free_index >= 0).sum())
    rows = np.arange(free_count, dtype=np.int64)
    keys = [rows * free_count + rows]
    for elements in groups:
        keys.append(_keys(*pair_nodes(np.asarray(elements, dtype=np.int64)), free_index)[0])
    key = np.unique(np.concatenate(keys))
    rows, columns = np.divmod(key, max(free_count, 1))
    return BlockPattern(
        row_starts=np.searchsorted(rows, np.arange(free_count + 1)).astype(np.int32),
        columns=columns.astype(np.int32),
        diagonal=np.flatnonzero(rows == columns).astype(np.int32),
    )


def pair_nodes(elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second node of each element block, shape [element_count * pair_count]."""
    first, second = np.triu_indices(elements.shape[1])
    return elements[:, first].ravel(), elements[:, second].ravel()


def block_gather(
    pattern: BlockPattern,
    first: np.ndarray,
    second: np.ndarray,
    free_index: np.ndarray,
    moving: np.ndarray | None = None,
) -> BlockGather:
    """Where parts d^2E / dx_first dx_second go, both int, shape [part_count].

    ``free_index``: see ``block_pattern``. ``moving``: prescribed nodes that do move (a gel on a
    mount), bool, shape [node_count]; none when left out.
    """
    free_index = np.asarray(free_index, dtype=np.int64)
    key, parts, turned = _keys(first, second, free_index)
    code = 2 * parts + turned
    blocks, starts, order = _sorted_ranges(key, code)
    keys = pattern.rows.astype(np.int64) * pattern.free_count + pattern.columns
    none = np.zeros(0, dtype=np.int64)
    rim_row, rim_code, rim_node = [none], [none], [none]
    if moving is not None:
        part = np.arange(len(first), dtype=np.int64)
        for own, other, turned in ((first, second, 0), (second, first, 1)):
            rim = (free_index[own] >= 0) & (free_index[other] < 0) & moving[other]
            rim_row.append(free_index[own[rim]])
            rim_code.append(2 * part[rim] + turned)
            rim_node.append(other[rim])
    rim_codes = np.concatenate(rim_code)
    rim_rows, rim_starts, rim_order = _sorted_ranges(np.concatenate(rim_row), rim_codes)
    return BlockGather(
        blocks=np.searchsorted(keys, blocks).astype(np.int32),
        source_starts=starts,
        sources=code[order].astype(np.int32),
        rim_rows=rim_rows.astype(np.int32),
        rim_starts=rim_starts,
        rim_sources=rim_codes[rim_order].astype(np.int32),
        rim_nodes=np.concatenate(rim_node)[rim_order].astype(np.int32),
    )


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


def _keys(
    first: np.ndarray, second: np.ndarray, free_index: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Key row * free_count + column in the lower triangle, number and whether it is transposed, of
    each part between free nodes."""
    free_count = int((free_index >= 0).sum())
    row, column = free_index[first], free_index[second]
    free = np.flatnonzero((row >= 0) & (column >= 0))
    row, column = row[free], column[free]
    return np.maximum(row, column) * free_count + np.minimum(row, column), free, row < column
