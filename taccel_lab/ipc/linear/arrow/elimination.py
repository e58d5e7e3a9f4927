# SPDX-License-Identifier: Apache-2.0
"""Symbolic block-arrow factorisation: order of elimination, blocks of the factor, and what is
subtracted from which.

Rows of gels are eliminated in the order of least degree [Tinney and Walker 1967]; rows of affine
bodies come last, as a border that is dense: a body may touch any gel node, and contact of a gel
with a body fills in nothing else. Columns that do not depend on each other form a level, which a
GPU eliminates at one time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.model.matrix_pattern import BlockPattern


@dataclass(frozen=True)
class Elimination:
    """Blocks of the factor, ordered by levels, and what has to be subtracted from which.

    A column has its diagonal block first, then those of all border rows, then those of gel rows.
    Places number the gel rows in the order of elimination.
    """

    order: np.ndarray
    """Row of the system at each place, [column_count]."""
    border: np.ndarray
    """Rows of the system in the border, ascending, [border_count]."""
    starts: np.ndarray
    """First block of each column, by places, [column_count]."""
    level_starts: np.ndarray
    """First block of each level, and the end, [level_count + 1]."""
    level_columns: np.ndarray
    """First place of each level, and the end: places are ordered by levels, [level_count + 1]."""
    columns: np.ndarray
    """Place of the column of each block, [block_count]."""
    codes: np.ndarray
    """Block of the pattern that each block starts from as 2 block + transposed, -1 for zero."""
    pair_starts: np.ndarray
    """Range of each block in ``pairs``, [block_count + 1]."""
    pairs: np.ndarray
    """Blocks a, b: a b^T is subtracted from the block, [pair_count, 2]."""
    inner: np.ndarray
    """(block, place of its row) of the blocks of gel rows below the diagonal, by columns,
    [inner_count, 2]."""

    @property
    def block_count(self) -> int:
        """Blocks of the factor, without those of the border among itself."""
        return len(self.columns)


def least_degree_order(
    neighbours: list[set[int]], haste: float = 0.0
) -> tuple[list[int], list[set[int]]]:
    """Order of elimination, and the rows that each eliminated one leaves coupled.

    A row with ``haste`` neighbours less is not preferred to one that can go a level earlier; among
    equals the earlier goes first. Haste means fewer levels, and more blocks.
    """
    graph = [set(n) for n in neighbours]
    waiting = set(range(len(graph)))
    level = [0] * len(graph)
    order, left = [], []
    while waiting:
        node = min(waiting, key=lambda i: (len(graph[i]) + haste * level[i], level[i], i))
        waiting.discard(node)
        others = graph[node]
        for other in others:
            graph[other] |= others
            graph[other] -= {other, node}
            level[other] = max(level[other], level[node] + 1)
        order.append(node)
        left.append(set(others))
    return order, left


def eliminate(pattern: BlockPattern, border: np.ndarray, haste: float = 0.0) -> Elimination:
    """Symbolic factorisation of ``pattern`` with the rows ``border`` last; see
    ``least_degree_order`` for ``haste``."""
    n = pattern.free_count
    is_border = np.zeros(n, dtype=bool)
    is_border[border] = True
    border = np.flatnonzero(is_border)
    inside = np.flatnonzero(~is_border)
    local = np.full(n, -1)
    local[inside] = np.arange(len(inside))
    neighbours: list[set[int]] = [set() for _ in inside]
    for row, column in zip(pattern.rows.tolist(), pattern.columns.tolist(), strict=True):
        if row != column and local[row] >= 0 and local[column] >= 0:
            neighbours[local[row]].add(int(local[column]))
            neighbours[local[column]].add(int(local[row]))
    sequence, left = least_degree_order(neighbours, haste)
    turn = np.empty(len(sequence), dtype=np.int64)
    turn[sequence] = np.arange(len(sequence))
    below = [sorted(int(turn[i]) for i in rows) for rows in left]
    # The level of a column is one more than the highest that it depends on.
    level = np.zeros(len(below), dtype=np.int64)
    for column, rows in enumerate(below):
        for row in rows:
            level[row] = max(level[row], level[column] + 1)
    by_level = np.lexsort((np.arange(len(below)), level))
    place = np.empty_like(by_level)
    place[by_level] = np.arange(len(by_level))
    structure = [sorted(int(place[i]) for i in below[column]) for column in by_level]
    order = inside[np.array(sequence, dtype=np.int64)[by_level]]
    return _number_blocks(pattern, order, border, structure, np.sort(level))


def _number_blocks(
    pattern: BlockPattern,
    order: np.ndarray,
    border: np.ndarray,
    structure: list[list[int]],
    levels: np.ndarray,
) -> Elimination:
    """Blocks and pairs of a factor whose columns have the gel rows ``structure``."""
    m = len(border)
    sizes = np.array([1 + m + len(rows) for rows in structure], dtype=np.int64)
    starts = np.cumsum(sizes) - sizes
    count = len(order)
    place_of = {count + c: c for c in range(m)}
    index = {}
    rows_of_blocks: list[int] = []
    for column, rows in enumerate(structure):
        block = int(starts[column])
        all_rows = [column, *place_of, *rows]
        for k, row in enumerate(all_rows):
            index[row, column] = block + k
        rows_of_blocks += all_rows
    pairs: list[list[tuple[int, int]]] = [[] for _ in rows_of_blocks]
    for column, rows in enumerate(structure):
        # Each later row j of this column takes a b^T from all rows i >= j of it.
        first = int(starts[column])
        extent = [*rows, *place_of]
        for k, j in enumerate(rows):
            b = index[j, column]
            for i in extent[k:]:
                pairs[index[i, j]].append((index[i, column], b))
        assert rows_of_blocks[first] == column
    rows_array = np.array(rows_of_blocks, dtype=np.int64)
    columns = np.repeat(np.arange(count), sizes)
    system_row = np.concatenate([order, border])
    level_count = int(levels.max(initial=-1)) + 1
    level_columns = np.searchsorted(levels, np.arange(level_count + 1))
    inner = [(index[i, j], i) for j, rows in enumerate(structure) for i in rows]
    block_starts = np.append(starts, sizes.sum())
    pair_starts, flat_pairs = _flat(pairs)
    return Elimination(
        order=order,
        border=border,
        starts=starts,
        level_starts=block_starts[level_columns],
        level_columns=level_columns,
        columns=columns,
        codes=_codes(pattern, system_row[rows_array], order[columns]),
        pair_starts=pair_starts,
        pairs=flat_pairs,
        inner=np.array(inner, dtype=np.int64).reshape(-1, 2),
    )


def _flat(lists: list[list[tuple[int, int]]]) -> tuple[np.ndarray, np.ndarray]:
    """Starts [count + 1] and entries [entry, 2] of lists of pairs."""
    starts = np.concatenate([[0], np.cumsum([len(entries) for entries in lists])])
    flat = [pair for entries in lists for pair in entries]
    return starts.astype(np.int64), np.array(flat, dtype=np.int64).reshape(-1, 2)


def _codes(pattern: BlockPattern, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """2 block + transposed of places of the full matrix in the pattern, -1 where it has none."""
    keys = pattern.rows.astype(np.int64) * pattern.free_count + pattern.columns
    key = np.maximum(rows, columns) * pattern.free_count + np.minimum(rows, columns)
    found = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    return np.where(keys[found] == key, 2 * found + (rows < columns), -1)


def border_codes(pattern: BlockPattern, border: np.ndarray) -> np.ndarray:
    """Codes of the blocks of border rows among themselves, row by row, [border_count^2]."""
    rows, columns = (index.ravel() for index in np.meshgrid(border, border, indexing="ij"))
    return _codes(pattern, rows, columns)
