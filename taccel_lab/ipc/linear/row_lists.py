# SPDX-License-Identifier: Apache-2.0
"""Both triangles of the pattern by rows, cut into segments of limited length.

A row gathers its product without atomics. Long rows (the control nodes of a body that a whole gel
touches) would keep one lane busy while the others wait: lanes work on segments instead, and whoever
owns a row adds up its segments.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.model.matrix_pattern import BlockPattern

SEGMENT_LENGTH = 12
"""Most blocks in a segment: rows of linear tets have about 7 to 16, of quadratic ones 15 to 60."""


def full_rows(
    pattern: BlockPattern, order: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts [row_count + 1], columns and codes [entry_count] of both triangles, the rows in the
    given order; a code is 2 block, or 2 block + 1 where the block is stored transposed."""
    block = np.arange(pattern.block_count, dtype=np.int64)
    upper = pattern.columns < pattern.rows
    row = np.concatenate([pattern.rows, pattern.columns[upper]])
    column = np.concatenate([pattern.columns, pattern.rows[upper]])
    code = np.concatenate([2 * block, 2 * block[upper] + 1])
    place = np.empty(pattern.free_count, dtype=np.int64)
    place[order] = np.arange(pattern.free_count)
    by_row = np.lexsort((column, place[row]))
    starts = np.searchsorted(place[row][by_row], np.arange(pattern.free_count + 1))
    return starts, column[by_row], code[by_row]


def cut_segments(starts: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """(row, first, end) of each segment, [segment_count, 3], and the first of each row,
    [row_count + 1]; the segments of a row differ by one block at most."""
    sizes = np.diff(starts)
    counts = -(-sizes // length)
    row_segments = np.concatenate([[0], np.cumsum(counts)])
    rows = np.repeat(np.arange(len(sizes)), counts)
    place = np.arange(row_segments[-1]) - row_segments[rows]
    first = starts[rows] + place * sizes[rows] // counts[rows]
    end = starts[rows] + (place + 1) * sizes[rows] // counts[rows]
    return np.stack([rows, first, end], axis=1), row_segments


def scalars(blocks: wp.array) -> wp.array:
    """The same memory as float64, [env_count, 9 per block or 3 per vector], or without the first of
    these when ``blocks`` have one dimension; keep them alive.

    A lane that needs one row of a block reads three numbers of it, not nine.
    """
    width = 9 if blocks.dtype == wp.mat33d else 3
    shape = (*blocks.shape[:-1], width * blocks.shape[-1])
    if not blocks.size:
        return wp.zeros(shape, dtype=wp.float64, device=blocks.device)
    return wp.array(ptr=blocks.ptr, shape=shape, dtype=wp.float64, device=blocks.device)
