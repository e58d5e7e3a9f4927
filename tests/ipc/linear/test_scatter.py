# SPDX-License-Identifier: Apache-2.0
"""Where a block of the lower triangle is in the pattern."""

from __future__ import annotations

import numpy as np
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.ipc.linear.scatter import find_block


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
