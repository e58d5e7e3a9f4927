# SPDX-License-Identifier: Apache-2.0
"""Inverses of diagonal blocks: 3x3 of single rows, turned where one is not positive definite, and
dense ones of clusters of rows.

A cluster is the four control nodes of an affine body: its 1e9 Pa couple them far more strongly than
anything else. On Newton matrices of the peg scene CG needs 100 iterations with single rows to 1e-4
and 47 with the body's 12x12 block.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.device.block_ops import Team, block_barrier, launch_team, team
from taccel_lab.ipc.device.dense_inverse import (
    address_of_tile,
    get_symmetric,
    lanes_for_inverse,
    put_lower,
    room_for_inverse,
    sweep_all,
)
from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.problem.arrays import LinearProblem
from taccel_lab.ipc.linear.problem.row_plan import RowPlan
from taccel_lab.ipc.linear.problem.turned import turning
from taccel_lab.model.env_lists import EnvMask

wp.set_module_options({"enable_backward": False})

_LANES = 128
_COMMON_WIDTH = 12
"""Scalar rows of most clusters: smaller ones use the same kernel."""


@wp.struct
class Clusters:
    """Dense diagonal blocks.

    spans: (first place, rows, first scalar in the store, first in codes), [cluster_count].
    codes: for each of their 3x3 blocks, row by row, the block of the pattern that holds it as
    2 block + transposed, or -1.
    tasks: (cluster, scalar row within it) of each scalar row by places, [3 clustered_count].
    store_size: scalars of all clusters.
    """

    spans: wp.array(dtype=wp.vec4i)
    codes: wp.array(dtype=wp.int32)
    tasks: wp.array(dtype=wp.vec2i)
    store_size: int


def cluster_lists(problem: LinearProblem, groups: Sequence[np.ndarray]) -> Clusters:
    """Lists of clusters, each given by its rows, on the device of the problem."""
    pattern = problem.pattern
    keys = pattern.rows.astype(np.int64) * pattern.free_count + pattern.columns
    counts = np.array([len(rows) for rows in groups], dtype=np.int64)
    starts = np.cumsum(counts) - counts
    code_starts = np.cumsum(counts**2) - counts**2
    codes = [np.zeros(0, dtype=np.int64)]
    for rows in groups:
        row, column = (index.ravel() for index in np.meshgrid(rows, rows, indexing="ij"))
        key = np.maximum(row, column) * pattern.free_count + np.minimum(row, column)
        found = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        codes.append(np.where(keys[found] == key, 2 * found + (row < column), -1))
    spans = np.stack([starts, counts, 9 * code_starts, code_starts], axis=1)
    owner = np.repeat(np.arange(len(counts)), 3 * counts)
    tasks = np.stack([owner, np.arange(len(owner)) - 3 * starts[owner]], axis=1)

    def put(array: np.ndarray, dtype: type) -> wp.array:
        return wp.array(array.astype(np.int32), dtype=dtype, device=problem.device)

    lists = Clusters()
    lists.spans, lists.tasks = put(spans, wp.vec4i), put(tasks, wp.vec2i)
    lists.codes = put(np.concatenate(codes), wp.int32)
    lists.store_size = int(9 * (counts**2).sum())
    return lists


@wp.func
def _load_cluster(
    lane: int,
    lanes: int,
    span: wp.vec4i,
    codes: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float64),
    memory: wp.uint64,
):
    """The lower triangle of the dense matrix of a cluster."""
    width = 3 * span[1]
    for e in range(lane, width * width, lanes):
        i = e / width
        j = e - width * i
        if j <= i:
            code = codes[span[3] + i / 3 * span[1] + j / 3]
            value = wp.float64(0.0)
            if code >= 0:
                at = 3 * (i % 3) + j % 3
                if code % 2 == 1:
                    at = 3 * (j % 3) + i % 3
                value = values[9 * (code / 2) + at]
            put_lower(memory, i, j, value)


@cache
def _inverse_kernel(room: int) -> Any:
    """The kernel that inverts blocks, with ``room`` numbers of shared memory."""
    address = address_of_tile(room)

    @wp.kernel(grid_stride=False, module="unique", enable_backward=False)
    def invert_clusters_kernel(
        lanes: int,
        blocks: int,
        active: wp.array(dtype=wp.int32),
        diagonal: wp.array(dtype=wp.int32),
        values: wp.array2d(dtype=wp.mat33d),
        scalar_values: wp.array2d(dtype=wp.float64),
        clusters: Clusters,
        stores: wp.array2d(dtype=wp.float64),
        inverses: wp.array2d(dtype=wp.mat33d),
    ):
        index, lane = wp.tid()
        memory = address(wp.tile_empty(shape=room, dtype=wp.float64, storage="shared"))
        env = index / blocks
        first = index % blocks
        if active[env] == 0:
            return
        for place in range(first * lanes + lane, diagonal.shape[0], blocks * lanes):
            block = diagonal[place]
            if block >= 0:
                whole = values[env, block]
                inverses[env, place] = wp.inverse(whole + wp.diag(turning(whole)))
        for c in range(first, clusters.spans.shape[0], blocks):
            span = clusters.spans[c]
            width = 3 * span[1]
            _load_cluster(lane, lanes, span, clusters.codes, scalar_values[env], memory)
            sweep_all(memory, width, lane, lanes)
            for e in range(lane, width * width, lanes):
                i = e / width
                stores[env, span[2] + e] = -get_symmetric(memory, i, e - width * i)
            block_barrier()

    return invert_clusters_kernel


@wp.func_native(native("preconditioner", "column_product"))
def _column_product(
    at: int,
    width: int,
    first: int,
    inverses: wp.array(dtype=wp.float64),
    r: wp.array(dtype=wp.float64),
) -> wp.float64:
    """Sum of inverses[at + width k] r[first + k]."""
    ...


@wp.func
def cluster_product(
    task: int, clusters: Clusters, stores: wp.array(dtype=wp.float64), r: wp.array(dtype=wp.float64)
) -> wp.float64:
    """One scalar, at scalar place ``task``, of M^-1 r in a cluster."""
    own = clusters.tasks[task]
    span = clusters.spans[own[0]]
    # Down a column, which equals the row: lanes side by side read numbers side by side.
    at = span[2] + own[1]
    return _column_product(at, 3 * span[1], 3 * span[0], stores, r)


@wp.func_native(native("preconditioner", "row_product"))
def _row_product(
    task: int, inverses: wp.array(dtype=wp.float64), r: wp.array(dtype=wp.float64)
) -> wp.float64:
    """One scalar of the inverse 3x3 block of its row times r."""
    ...


@wp.func
def preconditioned(
    task: int,
    clusters: Clusters,
    stores: wp.array(dtype=wp.float64),
    inverses: wp.array(dtype=wp.float64),
    r: wp.array(dtype=wp.float64),
) -> wp.float64:
    """One scalar, at scalar place ``task``, of M^-1 r."""
    if task < clusters.tasks.shape[0]:
        return cluster_product(task, clusters, stores, r)
    return _row_product(task, inverses, r)


def described(groups: Sequence[np.ndarray]) -> str:
    """The blocks of these clusters and of single rows, for people."""
    return f"3x3 blocks and {len(groups)} of bodies" if groups else "3x3 blocks"


class DiagonalInverses:
    """Inverses of the diagonal blocks of all environments."""

    def __init__(self, problem: LinearProblem, plan: RowPlan, lanes: int | None = None) -> None:
        """``lanes``: of a thread block on the CPU, for tests."""
        self._problem = problem
        device = problem.device
        widest = max([_COMMON_WIDTH, *(3 * int(size) for size in plan.cluster_sizes)])
        if not device.is_cpu:
            lanes = max(_LANES, lanes_for_inverse(widest))
        lanes = team(device, problem.env_count, 1, lanes).lanes
        blocks = 1
        if not device.is_cpu:
            # These blocks wait for nobody: single rows are shared, and clusters taken in turn.
            blocks = max(1, len(plan.cluster_sizes))
            if problem.env_count < int(device.sm_count):
                blocks = max(blocks, -(-problem.pattern.free_count // lanes))
        self._kernel = _inverse_kernel(room_for_inverse(widest))
        self._team = Team(lanes, blocks)
        diagonal = problem.pattern.diagonal[plan.order]
        # Their inverse stays zero: the cluster alone acts on these rows.
        diagonal[: plan.clustered] = -1
        self._diagonal = wp.array(diagonal, dtype=wp.int32, device=device)
        self.clusters = cluster_lists(problem, plan.groups())
        self.blocks = wp.zeros(problem.shape, dtype=wp.mat33d, device=device)
        """Inverse 3x3 blocks by places, zero for rows of clusters, [env_count, free_count]."""
        shape = (problem.env_count, self.clusters.store_size)
        self.stores = wp.zeros(shape, dtype=wp.float64, device=device)
        """Inverses of clusters row by row, shape [env_count, store_size]."""

    def update(self, active: EnvMask, scalar_values: wp.array) -> None:
        """Invert the diagonal blocks of the active environments."""
        problem, size = self._problem, self._team
        inputs = [size.lanes, size.blocks, active, self._diagonal, problem.values, scalar_values]
        launch_team(
            self._kernel, problem.env_count, size, *inputs, self.clusters, self.stores, self.blocks
        )
