# SPDX-License-Identifier: Apache-2.0
"""The matrix laid out for the lanes of a GPU: both triangles, in slices of 32 scalar rows.

A lane computes one scalar row of a segment (``row_plan``). The k-th numbers of the 32 lanes of a
warp lie side by side, so that a product reads whole cache lines; straight from the blocks of the
lower triangle, every lane would touch lines of its own. Copying the matrix costs about as much as
two products, of the twenty and more that a solve takes. Segments are sorted by length, so that a
slice wastes little: it is as long as the longest of its rows.

The copy is rounded to single precision, which halves what a product has to read: most of the time
of CG where many environments are in step. All else stays in double precision, products of the rows
of stiff bodies among it, and solves that go further than rounding allows are refined with the
matrix itself (``streamed_rows``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.device.block_ops import Team, launch_team, team
from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.problem.arrays import LinearProblem
from taccel_lab.ipc.linear.problem.row_plan import SEGMENT_LENGTH, RowPlan, cut_segments, full_rows
from taccel_lab.model.env_lists import EnvMask

wp.set_module_options({"enable_backward": False})

WIDTH = 32
"""Scalar rows in a slice: the lanes of a warp."""
GROUP = 4
"""Entries that a lane reads at a time: slices are filled up to a multiple of it. Those of a warp
are four copies of 16 bytes a lane, which the C++ here and in ``streamed_rows`` counts on."""
_LANES = 256
VERIFY_BELOW = 1e-3
"""Tolerance below which CG checks the residual with the matrix itself, and starts anew from there
where it falls short. With the rows of a stiff body rounded, too, it was off by 2e-3. On Newton
matrices of the benchmark scenes starting anew costs one iteration in two hundred, or none."""


@wp.struct
class RowSlices:
    """Layout shared by all environments; rows and columns are places of a ``RowPlan``.

    slices: (first in columns, entries of each lane), [slice_count].
    columns: columns of the entries, a slice's k-th 32 of them side by side, [entry_count].
    codes: block of each as 2 block + transposed, or -1 for none, [entry_count].
    segments: (row or -1 for none, number among the segments by rows), three scalar rows each,
    [sliced_count].
    row_segments: first segment of each row by rows, [row_count + 1].
    task_starts: first scalar row of the segments of each thread block, and the end,
    [block_count + 1].
    segment_count: segments by rows.
    """

    slices: wp.array(dtype=wp.vec2i)
    columns: wp.array(dtype=wp.int32)
    codes: wp.array(dtype=wp.int32)
    segments: wp.array(dtype=wp.vec2i)
    row_segments: wp.array(dtype=wp.int32)
    task_starts: wp.array(dtype=wp.int32)
    segment_count: int


def row_slices(problem: LinearProblem, plan: RowPlan, length: int = SEGMENT_LENGTH) -> RowSlices:
    """Layout of the pattern of a problem, on its device."""
    starts, columns, codes = full_rows(problem.pattern, plan.order)
    segments, row_segments = cut_segments(starts, length)
    sizes = segments[:, 2] - segments[:, 1]
    owner = np.searchsorted(plan.block_starts[1:-1], segments[:, 0], side="right")
    by_length = np.lexsort((-sizes, owner))
    # Three slices hold 32 segments: every block starts at its own slice.
    counts = np.bincount(owner, minlength=len(plan.block_starts) - 1)
    rooms = WIDTH * -(-counts // WIDTH)
    sliced = np.full(rooms.sum(), -1, dtype=np.int64)
    shift = np.cumsum(rooms) - rooms - (np.cumsum(counts) - counts)
    sliced[np.arange(len(by_length)) + shift[owner[by_length]]] = by_length
    sliced_sizes = np.where(sliced >= 0, sizes[sliced], 0)
    # The first lane of a slice has the longest row.
    lengths = sliced_sizes[np.arange(0, 3 * len(sliced), WIDTH) // 3]
    lengths = GROUP * -(-lengths // GROUP)
    firsts = WIDTH * (np.cumsum(lengths) - lengths)
    entry_count = WIDTH * int(lengths.sum())
    packed_columns = np.zeros(entry_count, dtype=np.int64)
    packed_codes = np.full(entry_count, -1, dtype=np.int64)
    task_sizes = np.repeat(sliced_sizes, 3)
    task = np.repeat(np.arange(len(task_sizes)), task_sizes)
    k = np.arange(len(task)) - np.repeat(np.cumsum(task_sizes) - task_sizes, task_sizes)
    at = firsts[task // WIDTH] + WIDTH * k + task % WIDTH
    entry = segments[sliced[task // 3], 1] + k
    packed_columns[at], packed_codes[at] = plan.places[columns[entry]], codes[entry]

    def put(array: np.ndarray, dtype: type = wp.int32) -> wp.array:
        return wp.array(array.astype(np.int32), dtype=dtype, device=problem.device)

    layout = RowSlices()
    layout.slices = put(np.stack([firsts, lengths], axis=1), wp.vec2i)
    layout.columns, layout.codes = put(packed_columns), put(packed_codes)
    rows = np.where(sliced >= 0, segments[sliced, 0], -1)
    layout.segments = put(np.stack([rows, sliced], axis=1), wp.vec2i)
    layout.row_segments = put(row_segments)
    layout.task_starts = put(3 * np.concatenate([[0], np.cumsum(rooms)]))
    layout.segment_count = len(segments)
    return layout


@wp.func
def pack_block_row(
    code: int,
    component: int,
    at: int,
    values: wp.array(dtype=wp.float64),
    packed: wp.array(dtype=Any),
):
    """Copy one row of a block (zero without a block) to its place in a slice."""
    if code >= 0:
        # Blocks of the upper triangle are stored transposed.
        start = 9 * (code >> 1) + 3 * component
        step = int(1)
        if code & 1:
            start = 9 * (code >> 1) + component
            step = int(3)
        packed[at] = packed.dtype(values[start])
        packed[at + 32] = packed.dtype(values[start + step])
        packed[at + 64] = packed.dtype(values[start + 2 * step])
    else:
        packed[at] = packed.dtype(0.0)
        packed[at + 32] = packed.dtype(0.0)
        packed[at + 64] = packed.dtype(0.0)


@wp.func
def pack_slices(
    first: int,
    step: int,
    layout: RowSlices,
    values: wp.array(dtype=wp.float64),
    packed: wp.array(dtype=wp.float32),
):
    """Copy scalar rows first, first + step, ... of the slices."""
    for task in range(first, 32 * layout.slices.shape[0], step):
        span = layout.slices[task / 32]
        place = task % 32
        for k in range(span[1]):
            at = span[0] + 32 * k
            code = layout.codes[at + place]
            pack_block_row(code, task % 3, 3 * at + place, values, packed)


@wp.kernel(grid_stride=False)
def _pack_kernel(
    block_lanes: int,
    blocks: int,
    active: wp.array(dtype=wp.int32),
    layout: RowSlices,
    values: wp.array2d(dtype=wp.float64),
    packed: wp.array2d(dtype=wp.float32),
):
    index, block_lane = wp.tid()
    env = index / blocks
    if active[env] == 0:
        return
    first = index % blocks * block_lanes + block_lane
    pack_slices(first, blocks * block_lanes, layout, values[env], packed[env])


@wp.func_native(native("packed_rows", "packed_product", GROUP=GROUP))
def packed_product(
    first: int,
    count: int,
    place: int,
    columns: wp.array(dtype=wp.int32),
    packed: wp.array(dtype=wp.float64),
    x: wp.array(dtype=wp.float64),
) -> wp.float64:
    """Product of a scalar row of a slice with x."""
    ...


class PackedRows:
    """Keeps a copy of the matrices of a problem in slices."""

    def __init__(self, problem: LinearProblem, plan: RowPlan, lanes: int | None = None) -> None:
        """``lanes``: of a thread block, for tests."""
        self._problem = problem
        device = problem.device
        self.layout = row_slices(problem, plan)
        tasks = WIDTH * len(self.layout.slices)
        lanes = team(device, problem.env_count, 1, lanes or _LANES).lanes
        blocks = 1 if device.is_cpu else -(-tasks // lanes)
        self._team = Team(lanes, blocks)
        shape = (problem.env_count, 3 * len(self.layout.columns))
        self.values = problem.scratch.take(shape, wp.float32, device)
        """Scalars of the slices, rounded, shape [env_count, 3 entry_count]."""

    def update(self, active: EnvMask, scalar_values: wp.array) -> None:
        """Copy the matrices of the active environments."""
        inputs = [self._team.lanes, self._team.blocks, active, self.layout, scalar_values]
        launch_team(_pack_kernel, self._problem.env_count, self._team, *inputs, self.values)
