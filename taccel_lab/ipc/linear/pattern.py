# SPDX-License-Identifier: Apache-2.0
"""The fixed sparsity pattern of the Newton matrix: 3x3 blocks between free nodes of one tet.

Contact with kinematic bodies couples only gel nodes that already share a face or an edge, so the
pattern is computed once per mesh and shared by all environments; only the values are per
environment, shape [env_count, block_count].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Pairs (i, j), i <= j, of a tet's corners, in the order in which element Hessians are stored.
TET_PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]


@dataclass(frozen=True)
class BlockPattern:
    """Block-CSR pattern over free nodes, with the element blocks that each entry gathers."""

    row_starts: np.ndarray
    """int32, shape [free_count + 1]."""
    columns: np.ndarray
    """Free-node columns, ascending within a row, int32, shape [block_count]."""
    diagonal: np.ndarray
    """Index of each row's diagonal block, int32, shape [free_count]."""
    source_starts: np.ndarray
    """int32, shape [block_count + 1]: range of each block in ``sources``."""
    sources: np.ndarray
    """Element blocks as 20 * tet + 2 * pair + transposed, int32, shape [source_count]."""


def tet_block_pattern(tets: np.ndarray, free_index: np.ndarray) -> BlockPattern:
    """Pattern of the stiffness matrix of linear tets.

    ``tets``: int, shape [tet_count, 4]. ``free_index``: row of each node or -1 when it is bonded,
    shape [node_count].
    """
    free_count = int((free_index >= 0).sum())
    rows, cols, codes = [], [], []
    tet_ids = np.arange(len(tets), dtype=np.int64)
    for pair, (i, j) in enumerate(TET_PAIRS):
        for transposed, (a, b) in enumerate(((i, j), (j, i)) if i != j else ((i, j),)):
            row, col = free_index[tets[:, a]], free_index[tets[:, b]]
            keep = (row >= 0) & (col >= 0)
            rows.append(row[keep])
            cols.append(col[keep])
            codes.append(20 * tet_ids[keep] + 2 * pair + transposed)
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
