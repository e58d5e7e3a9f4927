# SPDX-License-Identifier: Apache-2.0
"""In which order a solver keeps the rows, which of them are clusters, and which block owns them.

Places are row numbers of the solver. Clusters come first, one after the other, so that each is a
range of places; then single rows. Thread blocks own ranges of places, whole clusters each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.model.matrix_pattern import BlockPattern


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
    from scipy.sparse.csgraph import connected_components

    count, labels = connected_components(_graph(pattern)[rows][:, rows], directed=False)
    return [rows[labels == label] for label in range(count)]


def neighbour_clusters(pattern: BlockPattern, rows: np.ndarray, size: int) -> list[np.ndarray]:
    """Clusters of at most ``size`` of the rows, each of neighbours, by halving again and again.

    A part is halved along the breadth-first order from one of its ends, which keeps the cut short.
    """
    graph = _graph(pattern)
    clusters: list[np.ndarray] = []
    waiting = [np.sort(rows)]
    while waiting:
        part = waiting.pop()
        if len(part) <= size:
            if len(part):
                clusters.append(part)
            continue
        order = _from_end_to_end(graph[part][:, part])
        count = -(-len(part) // size)
        half = count // 2 * len(part) // count
        waiting += [part[order[half:]], part[order[:half]]]
    return [np.sort(cluster) for cluster in clusters]


def _graph(pattern: BlockPattern) -> Any:
    """Which rows are coupled, a scipy CSR array of both triangles."""
    from scipy.sparse import csr_array

    n = pattern.free_count
    lower = csr_array((np.ones(pattern.block_count), pattern.columns, pattern.row_starts), (n, n))
    return csr_array(lower + lower.T)


def _from_end_to_end(graph: object) -> np.ndarray:
    """Nodes in breadth-first order from one of the farthest from node 0."""
    from scipy.sparse.csgraph import breadth_first_order

    def order_from(node: int) -> np.ndarray:
        found = breadth_first_order(graph, node, directed=False, return_predecessors=False)
        count = graph.shape[0]  # type: ignore[attr-defined]
        return np.concatenate([found, np.setdiff1d(np.arange(count), found)])

    return order_from(int(order_from(0)[-1]))
