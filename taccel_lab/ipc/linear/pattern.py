# SPDX-License-Identifier: Apache-2.0
"""The fixed sparsity pattern of the Newton matrix: 3x3 blocks between free nodes of one tet.

Contact with kinematic bodies couples only gel nodes that already share a face or an edge, so the
pattern is computed once per mesh and shared by all environments; only the values are per
environment, shape [env_count, block_count]. The matrix is symmetric: its lower triangle is stored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Pairs (i, j), i <= j, of a tet's corners, in the order in which element Hessians are stored.
TET_PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]


@dataclass(frozen=True)
class BlockPattern:
    """Block-CSR pattern of the lower triangle, with the element blocks that each entry gathers."""

    row_starts: np.ndarray
    """int32, shape [free_count + 1]."""
    columns: np.ndarray
    """Free-node columns, ascending within a row and ending at the diagonal, int32,
    shape [block_count]."""
    diagonal: np.ndarray
    """Index of each row's diagonal block, int32, shape [free_count]."""
    source_starts: np.ndarray
    """int32, shape [block_count + 1]: range of each block in ``sources``."""
    sources: np.ndarray
    """Element blocks as 20 * tet + 2 * pair + transposed, int32, shape [source_count]."""

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
        """Full symmetric matrices of blocks [env_count, block_count, 3, 3], for inspection.

        Shape [env_count, 3 free_count, 3 free_count].
        """
        n = self.free_count
        full = np.zeros((len(values), n, n, 3, 3))
        full[:, self.columns, self.rows] = np.swapaxes(values, -1, -2)
        full[:, self.rows, self.columns] = values
        return full.transpose(0, 1, 3, 2, 4).reshape(len(values), 3 * n, 3 * n)


def tet_block_pattern(tets: np.ndarray, free_index: np.ndarray) -> BlockPattern:
    """Pattern of the stiffness matrix of linear tets.

    ``tets``: int, shape [tet_count, 4]. ``free_index``: row of each node or -1 when it is bonded,
    shape [node_count].
    """
    free_count = int((free_index >= 0).sum())
    rows, cols, codes = [], [], []
    tet_ids = np.arange(len(tets), dtype=np.int64)
    for pair, (i, j) in enumerate(TET_PAIRS):
        first, second = free_index[tets[:, i]], free_index[tets[:, j]]
        keep = (first >= 0) & (second >= 0)
        rows.append(np.maximum(first, second)[keep])
        cols.append(np.minimum(first, second)[keep])
        codes.append((20 * tet_ids + 2 * pair + (first < second))[keep])
    row, col, code = (np.concatenate(part).astype(np.int64) for part in (rows, cols, codes))
    order = np.lexsort((code, col, row))
    row, col, code = row[order], col[order], code[order]
    new_block = np.ones(len(row), dtype=bool)
    new_block[1:] = (row[1:] != row[:-1]) | (col[1:] != col[:-1])
    starts = np.flatnonzero(new_block)
    block_rows, columns = row[starts], col[starts]
    row_starts = np.searchsorted(block_rows, np.arange(free_count + 1))
    return BlockPattern(
        row_starts=row_starts.astype(np.int32),
        columns=columns.astype(np.int32),
        diagonal=np.flatnonzero(block_rows == columns).astype(np.int32),
        source_starts=np.append(starts, len(row)).astype(np.int32),
        sources=code.astype(np.int32),
    )
