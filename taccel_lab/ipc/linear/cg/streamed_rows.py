# SPDX-License-Identifier: Apache-2.0
"""Products of the packed matrix: streamed through shared memory, a warp a stretch of slices.

Half of the time of CG goes into this, and next to nothing of it is arithmetic. A lane that fetches
its entries itself waits twice for each: for the column, and for what that points to; the compiler
puts no two of them side by side, for want of registers. So copies of the next entries are always on
their way into shared memory, asynchronously, and all that a lane waits for is the vector. Each warp
reads one stretch of the matrix, of as many entries as the others.

Asynchronous copies need a chip of 2020 or later (sm_80). The CPU reads the matrix where it is.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.problem.packed_rows import GROUP, RowSlices
from taccel_lab.ipc.linear.problem.row_products import unpacked_product

wp.set_module_options({"enable_backward": False})

_STAGE_BYTES = 4 * 128 * GROUP
"""A group of entries of a warp: three float32 numbers and a column each."""
_LARGE_SHARED_BYTES = 160 * 1024
"""Shared memory of a block from which on a warp may have four stages, not two: that of chips for
data centres."""


def stages_of(device: wp.Device) -> int:
    """Groups of entries that each warp has room for, a power of two."""
    if device.is_cpu:
        return 0
    return 4 if int(device.max_shared_memory_per_block) >= _LARGE_SHARED_BYTES else 2


def room_for_stream(lanes: int, stages: int) -> int:
    """float64 numbers of shared memory for the stages of ``lanes`` lanes; 1 without any."""
    return max(1, lanes // 32 * stages * _STAGE_BYTES // 8)


@wp.struct
class Stream:
    """What a warp (on the CPU a lane) multiplies.

    slices: its first slice, and the end.
    first: first of their entries, as in ``RowSlices.slices``; groups: how many groups of them.
    memory: its shared memory; stages: how many it has room for.
    """

    slices: wp.vec2i
    first: int
    groups: int
    memory: wp.uint64
    stages: int


@wp.func_native(native("streamed_rows", "warp_width"))
def _warp_width() -> int:
    """Lanes of a warp; the CPU has one."""
    ...


@wp.func_native(native("streamed_rows", "memory_of", STAGE_BYTES=_STAGE_BYTES))
def _memory_of(memory: wp.uint64, warp: int, stages: int) -> wp.uint64:
    """The part of the shared memory of a block that a warp has."""
    ...


@wp.func
def _slice_from(entry: int, first: int, end: int, layout: RowSlices) -> int:
    """The first of slices first to end that begins at an entry or behind it."""
    low = int(first)
    high = int(end)
    while low < high:
        middle = (low + high) // 2
        if layout.slices[middle][0] < entry:
            low = middle + 1
        else:
            high = middle
    return low


@wp.func
def open_stream(
    lane: int,
    lanes: int,
    first_slice: int,
    end_slice: int,
    layout: RowSlices,
    memory: wp.uint64,
    stages: int,
) -> Stream:
    """The share of a lane's warp in slices first to end, by number of entries."""
    warp = lane / _warp_width()
    warps = lanes / _warp_width()
    stream = Stream()
    stream.memory = _memory_of(memory, warp, stages)
    stream.stages = stages
    if first_slice < end_slice:
        start = layout.slices[first_slice][0]
        last = layout.slices[end_slice - 1]
        count = (last[0] + 32 * last[1] - start) / 32
        # Slices begin at multiples of 32 entries.
        begin = start + 32 * int(wp.int64(count) * wp.int64(warp) / wp.int64(warps))
        stop = start + 32 * int(wp.int64(count) * wp.int64(warp + 1) / wp.int64(warps))
        own = _slice_from(begin, first_slice, end_slice, layout)
        behind = _slice_from(stop, own, end_slice, layout)
        stream.slices = wp.vec2i(own, behind)
        if own < behind:
            last = layout.slices[behind - 1]
            stream.first = layout.slices[own][0]
            stream.groups = (last[0] + 32 * last[1] - stream.first) / (32 * GROUP)
    return stream


_COPY = native("streamed_rows", "copy")


@wp.func_native(native("streamed_rows", "begin", COPY=_COPY))
def _begin(
    first: int,
    groups: int,
    memory: wp.uint64,
    stages: int,
    columns: wp.array(dtype=wp.int32),
    packed: wp.array(dtype=wp.float32),
) -> None: ...


@wp.func_native(native("streamed_rows", "end_stream"))
def end_stream() -> None:
    """Wait for copies that nobody will read; to be called before a kernel ends."""
    ...


@wp.func
def begin_stream(stream: Stream, layout: RowSlices, packed: wp.array(dtype=wp.float32)):
    """Start the copies of the first groups of a stream: before every product, and best before the
    barrier after which the vector is there."""
    _begin(stream.first, stream.groups, stream.memory, stream.stages, layout.columns, packed)


@wp.func_native(native("streamed_rows", "slice_product", COPY=_COPY))
def _slice_product(
    task: int,
    group: int,
    count: int,
    first: int,
    groups: int,
    memory: wp.uint64,
    stages: int,
    columns: wp.array(dtype=wp.int32),
    packed: wp.array(dtype=wp.float32),
    x: wp.array(dtype=wp.float64),
) -> wp.float64:
    """Product of scalar row ``task`` with x: entries from ``group`` of the stream on, ``count`` of
    them. To be called by all lanes of a warp, for the slices of the stream one after the other."""
    ...


@wp.func
def multiply_streamed(
    lane: int,
    stream: Stream,
    exact_rows: int,
    layout: RowSlices,
    values: wp.array(dtype=wp.float64),
    packed: wp.array(dtype=wp.float32),
    x: wp.array(dtype=wp.float64),
    parts: wp.array(dtype=wp.float64),
) -> wp.float64:
    """parts = A x for the scalar rows of the segments of a stream that was begun, without the
    extra blocks. Returns a lane's share of x . A x. The first ``exact_rows`` are multiplied as they
    are, those behind them rounded."""
    width = _warp_width()
    share = wp.float64(0.0)
    group = int(0)
    following = int(0)
    if stream.slices[0] < stream.slices[1]:
        following = layout.slices[stream.slices[0]][1]
    for s in range(stream.slices[0], stream.slices[1]):
        count = following
        if s + 1 < stream.slices[1]:
            following = layout.slices[s + 1][1]
        for task in range(32 * s + lane % width, 32 * s + 32, width):
            segment = layout.segments[task / 3]
            part = _slice_product(
                task,
                group,
                count,
                stream.first,
                stream.groups,
                stream.memory,
                stream.stages,
                layout.columns,
                packed,
                x,
            )
            if segment[0] >= 0:
                if segment[0] < exact_rows:
                    part = unpacked_product(task, layout, values, x)
                parts[3 * segment[1] + task % 3] = part
                share += part * x[3 * segment[0] + task % 3]
        group += count / GROUP
    return share
