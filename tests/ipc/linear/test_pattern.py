# SPDX-License-Identifier: Apache-2.0
"""The block pattern against a dense assembly of the element blocks."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.ipc.linear.pattern import TET_PAIRS, tet_block_pattern


@pytest.mark.parametrize("seed", range(4))
def test_gathered_blocks_equal_dense_assembly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tets = np.stack([rng.permutation(12)[:4] for _ in range(20)]).astype(np.int32)
    free_index = np.full(12, -1, dtype=np.int32)
    free = rng.permutation(12)[:9]
    free_index[free] = rng.permutation(9)
    pattern = tet_block_pattern(tets, free_index)

    elements = rng.normal(size=(len(tets), 4, 3, 4, 3))
    elements += elements.transpose(0, 3, 4, 1, 2)
    expected = np.zeros((9, 3, 9, 3))
    for tet, element in zip(tets, elements, strict=True):
        for i in range(4):
            for j in range(4):
                row, column = free_index[tet[i]], free_index[tet[j]]
                if row >= 0 and column >= 0:
                    expected[row, :, column] += element[i, :, j]

    stored = np.stack([elements[:, i, :, j] for i, j in TET_PAIRS], axis=1)
    values = np.zeros((1, pattern.block_count, 3, 3))
    for block in range(pattern.block_count):
        first, end = pattern.source_starts[block : block + 2]
        for code in pattern.sources[first:end]:
            part = stored[code // 20, (code % 20) // 2]
            values[0, block] += part.T if code % 2 else part

    assert (pattern.columns <= pattern.rows).all()
    assert (pattern.columns[pattern.diagonal] == np.arange(9)).all()
    assert (pattern.diagonal == pattern.row_starts[1:] - 1).all()
    np.testing.assert_allclose(
        pattern.dense(values)[0], expected.reshape(27, 27), rtol=0, atol=1e-13
    )
