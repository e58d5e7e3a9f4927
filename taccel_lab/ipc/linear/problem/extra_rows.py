# SPDX-License-Identifier: Apache-2.0
"""Extra blocks by rows, with one entry for each place, on the device.

A contact between a gel and an affine body adds up to a dozen blocks to the list, and most of them
fall on the same few places: in the peg scene 2,000 blocks on 240. An iteration of CG that read all
of them would spend more on the list than on the gels. One block of threads an environment sums what
belongs together, in place - the matrix stays the same - writes row lists of what is left, and lays
those out in slices (``packed_rows``), as far as the room for them goes.

The order of the list is that in which a GPU's threads got their slots, so that the last bits of the
sums may differ from run to run. Where bits count (``LinearProblem.in_any_order``) the blocks of one
place have an exact sum, and row lists are brought in order (``extra_layout``).
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.device.block_ops import Team, block_barrier, launch_team, team
from taccel_lab.ipc.linear.problem.arrays import LinearProblem
from taccel_lab.ipc.linear.problem.extra_layout import (
    ExtraRows,
    cut_row,
    extra_slice,
    is_long,
    order_kernel,
    pack_extra,
    segments_of,
    slice_length,
)
from taccel_lab.ipc.linear.problem.packed_rows import WIDTH
from taccel_lab.ipc.linear.problem.row_plan import SEGMENT_LENGTH, RowPlan, scalars
from taccel_lab.model.env_lists import EnvMask, Envs, env_at

wp.set_module_options({"enable_backward": False})

CROWD = 64
"""Blocks of one column above which they are added up by all lanes, with atomics, instead of by one
lane a component: a column of a body in contact with another has thousands."""
_LANES = 256
_ENTRY_BYTES = 8 + 16 + 8
"""Memory of a block here, at most: in two orders, two entries, their segments."""
_SLICE_BYTES = 210
"""Likewise in slices."""


@wp.func
def _claim_ranges(
    lane: int,
    lanes: int,
    sizes: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    totals: wp.array(dtype=wp.int32),
):
    """Give every row a range of entries; its end moves from the first entry as they arrive."""
    for row in range(lane, sizes.shape[0], lanes):
        if sizes[row] > 0:
            ends[row] = wp.atomic_add(totals, 0, sizes[row])


@wp.func
def _owner(
    k: int,
    first: int,
    places: wp.array(dtype=wp.vec2i),
    order: wp.array(dtype=wp.int32),
) -> int:
    """The first block in the same place as block k, in the bucket of its column."""
    row = places[k][0]
    e = first
    while places[order[e]][0] != row:
        e += 1
    return order[e]


@wp.func
def _sum_component(
    first: int,
    end: int,
    component: int,
    order: wp.array(dtype=wp.int32),
    owners: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float64),
):
    """Add one component of each block to that of its owner, and leave zero."""
    for e in range(first, end):
        k = order[e]
        owner = owners[k]
        if owner != k:
            values[9 * owner + component] += values[9 * k + component]
            values[9 * k + component] = wp.float64(0.0)


@wp.func
def _sum_crowd(k: int, owner: int, values: wp.array(dtype=wp.float64)):
    """The same for all components of a block among very many."""
    count = int(9)
    for component in range(count):
        wp.atomic_add(values, 9 * owner + component, values[9 * k + component])
        values[9 * k + component] = wp.float64(0.0)


@wp.func
def _cut_rows(
    env: int,
    lane: int,
    lanes: int,
    segment_length: int,
    long: bool,
    row_places: wp.array(dtype=wp.int32),
    sizes: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    rows: ExtraRows,
):
    """Give every row with long, or with short, segments a range of entries, and cut it."""
    for row in range(lane, sizes.shape[0], lanes):
        size = sizes[row]
        if size > 0 and is_long(size, segment_length) == long:
            count = segments_of(size, segment_length)
            first = wp.atomic_add(rows.totals, env, 0, size)
            ends[row] = first
            segment = wp.atomic_add(rows.totals, env, 1, count)
            cut_row(env, row_places[row], first, size, segment, count, rows)


@wp.func
def _claim_slices(env: int, lane: int, lanes: int, rows: ExtraRows):
    """Find room for every slice, as long as the longest of its rows; -1 where there is none."""
    segment_count = rows.totals[env, 1]
    room = rows.starts[env + 1][2] - rows.starts[env][2]
    for s in range(lane, (3 * segment_count + 31) / 32, lanes):
        length = slice_length(env, s, rows)
        first = wp.atomic_add(rows.totals, env, 2, 32 * length)
        if first + 32 * length > room:
            first = int(-1)
        rows.slices[extra_slice(env, rows) + s] = wp.vec2i(first, length)


@wp.kernel(grid_stride=False)
def _merge_kernel(
    lanes: int,
    segment_length: int,
    crowd: int,
    active: Envs,
    row_places: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    all_places: wp.array(dtype=wp.vec2i),
    all_values: wp.array(dtype=wp.float64),
    all_order: wp.array(dtype=wp.int32),
    all_owners: wp.array(dtype=wp.int32),
    all_sizes: wp.array2d(dtype=wp.int32),
    all_ends: wp.array2d(dtype=wp.int32),
    rows: ExtraRows,
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    first = rows.starts[env][0]
    end = rows.starts[env + 1][0]
    count = wp.min(counts[env], end - first)
    places = all_places[first:end]
    values = all_values[9 * first : 9 * end]
    order = all_order[first:end]
    owners = all_owners[first:end]
    sizes = all_sizes[env]
    ends = all_ends[env]
    totals = rows.totals[env]
    row_count = sizes.shape[0]
    for row in range(lane, row_count, lanes):
        sizes[row] = 0
        rows.row_segments[env, row] = wp.vec2i(0, 0)
    if lane == 0:
        totals[0] = 0
        totals[1] = 0
        totals[2] = 0
    block_barrier()
    if count <= 0:
        return
    # Buckets of one column each: gel nodes, which come before the control nodes in rows.
    for k in range(lane, count, lanes):
        wp.atomic_add(sizes, places[k][1], 1)
    block_barrier()
    _claim_ranges(lane, lanes, sizes, ends, totals)
    block_barrier()
    for k in range(lane, count, lanes):
        order[wp.atomic_add(ends, places[k][1], 1)] = k
    block_barrier()
    for k in range(lane, count, lanes):
        column = places[k][1]
        owners[k] = _owner(k, ends[column] - sizes[column], places, order)
    if lane == 0:
        totals[0] = 0
    block_barrier()
    for task in range(lane, 9 * row_count, lanes):
        row = task / 9
        if sizes[row] > 0 and sizes[row] <= crowd:
            _sum_component(ends[row] - sizes[row], ends[row], task - 9 * row, order, owners, values)
    for k in range(lane, count, lanes):
        if owners[k] != k and sizes[places[k][1]] > crowd:
            _sum_crowd(k, owners[k], values)
    block_barrier()
    for row in range(lane, row_count, lanes):
        sizes[row] = 0
    block_barrier()
    for k in range(lane, count, lanes):
        if owners[k] == k:
            wp.atomic_add(sizes, places[k][0], 1)
            wp.atomic_add(sizes, places[k][1], 1)
    block_barrier()
    _cut_rows(env, lane, lanes, segment_length, True, row_places, sizes, ends, rows)
    block_barrier()
    _cut_rows(env, lane, lanes, segment_length, False, row_places, sizes, ends, rows)
    block_barrier()
    for k in range(lane, count, lanes):
        if owners[k] == k:
            i = places[k][0]
            j = places[k][1]
            at_i = wp.atomic_add(ends, i, 1)
            rows.columns[2 * first + at_i] = row_places[j]
            rows.codes[2 * first + at_i] = 2 * k
            at_j = wp.atomic_add(ends, j, 1)
            rows.columns[2 * first + at_j] = row_places[i]
            rows.codes[2 * first + at_j] = 2 * k + 1
    _claim_slices(env, lane, lanes, rows)
    block_barrier()
    pack_extra(env, lane, lanes, values, rows)


class ExtraRowLists:
    """Keeps ``rows`` up to date with the extra blocks of a problem."""

    def __init__(
        self,
        problem: LinearProblem,
        plan: RowPlan | None = None,
        lanes: int | None = None,
        in_slices: bool = True,
    ) -> None:
        """``plan``: places of the rows, the rows themselves when left out. ``lanes``: of a thread
        block, for tests. ``in_slices``: whether blocks are laid out in slices, too; products that
        are rare do without."""
        self._problem = problem
        self._in_slices = in_slices
        size = team(problem.device, problem.env_count, 1, lanes or _LANES)
        self._team = Team(size.lanes)
        order = np.arange(problem.pattern.free_count) if plan is None else plan.places
        self._row_places = wp.array(order.astype(np.int32), dtype=wp.int32, device=problem.device)
        self._sizes = wp.zeros(problem.shape, dtype=wp.int32, device=problem.device)
        self._ends = wp.zeros(problem.shape, dtype=wp.int32, device=problem.device)
        entry_bytes = _ENTRY_BYTES + _SLICE_BYTES * in_slices + 8 * problem.in_any_order
        problem.extra.entry_bytes += entry_bytes
        rows = self.rows = ExtraRows()
        rows.starts = self._empty(problem.env_count + 1, wp.vec3i)
        rows.totals = self._empty((problem.env_count, 3))
        rows.row_segments = self._empty(problem.shape, wp.vec2i)
        self._allocate(0, 0)
        problem.extra.follow(self._fit)

    def _empty(self, shape: int | tuple[int, int], dtype: type = wp.int32) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self._problem.device)

    def _fit(self, before: wp.array) -> None:
        """Make room for the list as long as it is now."""
        problem, extra = self._problem, self._problem.extra
        entries, n = 2 * extra.rooms, problem.pattern.free_count
        segments = np.minimum(entries, entries // SEGMENT_LENGTH + np.minimum(n, entries))
        # Three slices hold as many segments as they are wide: each environment begins a slice.
        segments = WIDTH * -(-segments // WIDTH)
        # Room for four blocks a row, as a body that touches all of them needs; and for filling up.
        packed = np.minimum(entries, 4 * n)
        longest = np.minimum(entries, SEGMENT_LENGTH)
        packed = WIDTH * (-(-15 * packed // (4 * WIDTH)) + 2 * longest) * self._in_slices
        starts = np.zeros((problem.env_count + 1, 3), dtype=np.int64)
        starts[1:] = np.cumsum(np.stack([extra.rooms, segments, packed], axis=1), axis=0)
        self.rows.starts.assign(starts.astype(np.int32))
        needed = starts[-1, 1:]
        held = (len(self.rows.segments), len(self.rows.packed_columns))
        if extra.capacity > len(self._order) or (needed > held).any():
            self._allocate(*(needed + (extra.spare * needed).astype(np.int64)).tolist())
            extra.moves += 1

    def _allocate(self, segment_count: int, packed_count: int) -> None:
        empty, rows, capacity = self._empty, self.rows, self._problem.extra.capacity
        self._order, self._owners = empty(capacity), empty(capacity)
        rows.columns, rows.codes = empty(2 * capacity), empty(2 * capacity)
        if self._problem.in_any_order:
            self._came = empty(2 * capacity)
        rows.segments = empty(segment_count, wp.vec3i)
        rows.parts = empty(segment_count, wp.vec3d)
        rows.part_scalars = scalars(rows.parts)
        rows.slices = empty(3 * -(-segment_count // WIDTH), wp.vec2i)
        rows.packed_columns = empty(packed_count)
        rows.packed = empty(3 * packed_count, wp.float64)

    @property
    def values(self) -> wp.array:
        """Extra blocks as scalars, summed by ``update``, [9 capacity]."""
        return scalars(self._problem.extra.values)

    def update(self, active: EnvMask) -> None:
        """Sum blocks of the same place and list them by rows."""
        problem = self._problem
        extra = problem.extra
        inputs = [self._team.lanes, SEGMENT_LENGTH, CROWD, active, self._row_places, extra.counts]
        inputs += [extra.places, self.values, self._order, self._owners, self._sizes, self._ends]
        launch_team(_merge_kernel, problem.env_count, self._team, *inputs, self.rows)
        if problem.in_any_order:
            inputs = [self._team.lanes, SEGMENT_LENGTH, active, self._row_places, extra.counts]
            inputs += [extra.places, self.values, self._owners, self._sizes, self._ends, self._came]
            launch_team(order_kernel, problem.env_count, self._team, *inputs, self.rows)
