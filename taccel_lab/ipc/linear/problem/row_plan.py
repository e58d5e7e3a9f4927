# SPDX-License-Identifier: Apache-2.0
"""The rows of the pattern: their lists, their order, their owners.

Both triangles of the pattern by rows, cut into segments of limited length.

A row gathers its product without atomics. Long rows (the control nodes of a body that a whole gel
touches) would keep one lane busy while the others wait: lanes work on segments instead, and whoever
owns a row adds up its segments.

In which order a solver keeps the rows, which of them are clusters, and which block owns them.

Places are row numbers of the solver. Clusters come first, one after the other, so that each is a
range of places; then single rows. Thread blocks own ranges of places, whole clusters each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.geometry.connectivity import pieces_of_pairs
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


@dataclass(frozen=True)
class RowPlan:
    """Rows by place."""

    order: np.ndarray
    """Row at each place, [row_count]."""
    places: np.ndarray
    """Place of each row, [row_count]."""
    cluster_sizes: np.ndarray
    """Rows of each cluster, [cluster_count]."""
    block_starts: np.ndarray
    """First place of each thread block, and the end, [block_count + 1]."""

    @property
    def clustered(self) -> int:
        """Rows in clusters."""
        return int(self.cluster_sizes.sum())

    def groups(self) -> list[np.ndarray]:
        """Rows of each cluster."""
        ends = np.cumsum(self.cluster_sizes)
        return np.split(self.order[: self.clustered], ends[:-1]) if len(ends) else []


def plan_rows(
    row_count: int,
    groups: Sequence[np.ndarray],
    blocks: int = 1,
    parts: Sequence[np.ndarray] = (),
) -> RowPlan:
    """Order rows for ``blocks`` thread blocks, with about as many places each.

    ``groups``: rows of each cluster. ``parts``: single rows that follow each other, part by part.
    """
    clustered = np.concatenate([np.zeros(0, dtype=np.int64), *groups])
    listed = np.concatenate([clustered, *parts])
    order = np.concatenate([listed, np.setdiff1d(np.arange(row_count), listed)])
    order = order.astype(np.int64)
    places = np.empty_like(order)
    places[order] = np.arange(row_count)
    sizes = np.array([len(rows) for rows in groups], dtype=np.int64)
    cuts = np.concatenate([np.cumsum(sizes), np.arange(len(clustered), row_count) + 1])
    wanted = np.arange(1, blocks) * row_count / blocks
    cuts = np.concatenate([[0], cuts])
    nearest = np.abs(cuts[:, None] - wanted).argmin(axis=0) if len(wanted) else []
    starts = np.concatenate([[0], np.sort(cuts[nearest]), [row_count]]).astype(np.int64)
    return RowPlan(order, places, sizes, starts)


def connected_rows(pattern: BlockPattern, rows: np.ndarray) -> list[np.ndarray]:
    """The rows by what hangs together among themselves, as the nodes of a gel do."""
    place = np.full(pattern.free_count, -1)
    place[rows] = np.arange(len(rows))
    pairs = place[np.stack([pattern.rows, pattern.columns], axis=1)]
    labels = pieces_of_pairs(pairs[(pairs >= 0).all(axis=1)], len(rows))
    return [rows[labels == label] for label in range(labels.max(initial=-1) + 1)]


def neighbour_clusters(pattern: BlockPattern, rows: np.ndarray, size: int) -> list[np.ndarray]:
    """Clusters of at most ``size`` of the rows, each of neighbours, by halving again and again.

    A part is halved along the breadth-first order from one of its ends, which keeps the cut short.
    """
    starts, columns, _ = full_rows(pattern, np.arange(pattern.free_count))
    clusters: list[np.ndarray] = []
    waiting = [np.sort(rows)]
    while waiting:
        part = waiting.pop()
        if len(part) <= size:
            if len(part):
                clusters.append(part)
            continue
        ordered = _from_end_to_end(starts, columns, part)
        count = -(-len(part) // size)
        half = count // 2 * len(part) // count
        waiting += [ordered[half:], ordered[:half]]
    return [np.sort(cluster) for cluster in clusters]


def _from_end_to_end(starts: np.ndarray, columns: np.ndarray, part: np.ndarray) -> np.ndarray:
    """The rows of a part in breadth-first order from one of the farthest from its first."""

    def order_from(row: int) -> np.ndarray:
        left = np.zeros(len(starts) - 1, dtype=bool)
        left[part] = True
        left[row] = False
        reached = [np.array([row])]
        while len(reached[-1]):
            sizes = np.diff(starts)[reached[-1]]
            within = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
            found = columns[np.repeat(starts[reached[-1]], sizes) + within]
            found = found[left[found]]
            left[found] = False
            reached.append(found[np.sort(np.unique(found, return_index=True)[1])])
        return np.concatenate([*reached, part[left[part]]])

    return order_from(int(order_from(int(part[0]))[-1]))
