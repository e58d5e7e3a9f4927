# SPDX-License-Identifier: Apache-2.0
"""Row lists of extra blocks, their copy in slices, and how both are brought in order.

Threads of a GPU fill the lists of ``extra_rows`` as they come: which entry of a row is first, which
segment is whose, and with that the last digits of products and of their sums differ from run to
run. Where bits count they are laid out anew: entries of a row by columns, rows with long segments
before those with short ones, each by number.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.block_ops import block_barrier
from taccel_lab.ipc.linear.problem.packed_rows import pack_block_row

wp.set_module_options({"enable_backward": False})


@wp.struct
class ExtraRows:
    """Row lists of the extra blocks of every environment; rows and columns are places.

    The arrays hold those of all environments, one after the other, as the list does; what they say
    of places is counted from the first of an environment.

    starts: first block in the list, first segment and first of packed_columns of each environment,
    and the ends, [env_count + 1].
    totals: entries, segments and room in slices in use, [env_count, 3].
    columns, codes: column of each entry and its block as 2 place in the list + transposed, two
    entries a block.
    segments: (row, first entry, end).
    parts: products of segments; part_scalars: the same memory.
    row_segments: (first segment, count) of each row, [env_count, row_count].
    slices: (first in packed_columns or -1 without room, entries of each lane), of 32 scalar rows of
    the segments each.
    packed_columns, packed: see ``RowSlices`` and ``PackedRows``.
    """

    starts: wp.array(dtype=wp.vec3i)
    totals: wp.array2d(dtype=wp.int32)
    columns: wp.array(dtype=wp.int32)
    codes: wp.array(dtype=wp.int32)
    segments: wp.array(dtype=wp.vec3i)
    parts: wp.array(dtype=wp.vec3d)
    part_scalars: wp.array(dtype=wp.float64)
    row_segments: wp.array2d(dtype=wp.vec2i)
    slices: wp.array(dtype=wp.vec2i)
    packed_columns: wp.array(dtype=wp.int32)
    packed: wp.array(dtype=wp.float64)


@wp.func
def extra_slice(env: int, rows: ExtraRows) -> int:
    """First slice of an environment."""
    return 3 * rows.starts[env][1] / 32


@wp.func
def slice_length(env: int, s: int, rows: ExtraRows) -> int:
    """Entries of the longest row of a slice."""
    segments = rows.starts[env][1]
    length = int(0)
    begin = 32 * s // 3
    for segment in range(begin, wp.min((32 * s + 31) / 3 + 1, rows.totals[env, 1])):
        span = rows.segments[segments + segment]
        length = wp.max(length, span[2] - span[1])
    return length


@wp.func
def pack_extra(
    env: int, lane: int, lanes: int, values: wp.array(dtype=wp.float64), rows: ExtraRows
):
    """Fill the slices."""
    segment_count = rows.totals[env, 1]
    entries = 2 * rows.starts[env][0]
    segments = rows.starts[env][1]
    packed = rows.starts[env][2]
    for task in range(lane, (3 * segment_count + 31) / 32 * 32, lanes):
        span = rows.slices[extra_slice(env, rows) + task / 32]
        place = task % 32
        first = int(0)
        count = int(0)
        if task / 3 < segment_count:
            segment = rows.segments[segments + task / 3]
            first = segment[1]
            count = segment[2] - first
        length = span[1]
        if span[0] < 0:
            length = int(0)
        for k in range(length):
            at = packed + span[0] + 32 * k
            code = int(-1)
            column = int(0)
            if k < count:
                code = rows.codes[entries + first + k]
                column = rows.columns[entries + first + k]
            rows.packed_columns[at + place] = column
            pack_block_row(code, task % 3, 3 * at + place, values, rows.packed)


@wp.func
def segments_of(size: int, segment_length: int) -> int:
    """Segments of a row of ``size`` entries."""
    return (size + segment_length - 1) // segment_length


@wp.func
def is_long(size: int, segment_length: int) -> bool:
    """Whether the segments of a row of ``size`` entries are longer than half of the most."""
    return 2 * size > segment_length * segments_of(size, segment_length)


@wp.func
def cut_row(env: int, place: int, first: int, size: int, segment: int, count: int, rows: ExtraRows):
    """Cut the entries of a row into ``count`` segments; the first ones of both are given."""
    rows.row_segments[env, place] = wp.vec2i(segment, count)
    for s in range(count):
        rows.segments[rows.starts[env][1] + segment + s] = wp.vec3i(
            place, first + s * size / count, first + (s + 1) * size / count
        )


@wp.func
def _cut_in_order(
    env: int,
    row: int,
    place: int,
    segment_length: int,
    sizes: wp.array(dtype=wp.int32),
    rows: ExtraRows,
):
    """Entries and segments of a row follow those of all rows before it."""
    size = sizes[row]
    own_is_long = is_long(size, segment_length)
    first = int(0)
    segment = int(0)
    for other in range(sizes.shape[0]):
        more = sizes[other]
        if more > 0:
            other_is_long = is_long(more, segment_length)
            earlier = other_is_long == own_is_long and other < row
            if (other_is_long and not own_is_long) or earlier:
                first += more
                segment += segments_of(more, segment_length)
    cut_row(env, place, first, size, segment, segments_of(size, segment_length), rows)


@wp.func
def _put_in_order(
    env: int,
    place: int,
    column: int,
    code: int,
    came: int,
    end: int,
    columns: wp.array(dtype=wp.int32),
    rows: ExtraRows,
):
    """Put an entry among those of its row, which came from ``came`` to ``end``; no other of them
    has its column."""
    segment = rows.segments[rows.starts[env][1] + rows.row_segments[env, place][0]]
    at = 2 * rows.starts[env][0] + segment[1]
    for other in range(came, end):
        if columns[other] < column:
            at += 1
    rows.columns[at] = column
    rows.codes[at] = code


@wp.kernel(grid_stride=False)
def order_kernel(
    lanes: int,
    segment_length: int,
    active: wp.array(dtype=wp.int32),
    row_places: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    all_places: wp.array(dtype=wp.vec2i),
    all_values: wp.array(dtype=wp.float64),
    all_owners: wp.array(dtype=wp.int32),
    all_sizes: wp.array2d(dtype=wp.int32),
    all_ends: wp.array2d(dtype=wp.int32),
    all_came: wp.array(dtype=wp.int32),
    rows: ExtraRows,
):
    """Lay out row lists anew; ``all_owners`` to ``all_ends`` as ``extra_rows`` left them."""
    env, lane = wp.tid()
    first = rows.starts[env][0]
    end = rows.starts[env + 1][0]
    count = wp.min(counts[env], end - first)
    if active[env] == 0 or count <= 0:
        return
    places = all_places[first:end]
    owners = all_owners[first:end]
    came = all_came[2 * first : 2 * end]
    sizes = all_sizes[env]
    ends = all_ends[env]
    for entry in range(lane, rows.totals[env, 0], lanes):
        came[entry] = rows.columns[2 * first + entry]
    for row in range(lane, sizes.shape[0], lanes):
        if sizes[row] > 0:
            _cut_in_order(env, row, row_places[row], segment_length, sizes, rows)
    block_barrier()
    for k in range(lane, count, lanes):
        if owners[k] == k:
            for side in range(2):
                row = places[k][side]
                column = row_places[places[k][1 - side]]
                _put_in_order(
                    env,
                    row_places[row],
                    column,
                    2 * k + side,
                    ends[row] - sizes[row],
                    ends[row],
                    came,
                    rows,
                )
    room = rows.starts[env + 1][2] - rows.starts[env][2]
    slices = extra_slice(env, rows)
    slice_count = (3 * rows.totals[env, 1] + 31) / 32
    for s in range(lane, slice_count, lanes):
        rows.slices[slices + s] = wp.vec2i(0, slice_length(env, s, rows))
    block_barrier()
    for s in range(lane, slice_count, lanes):
        length = rows.slices[slices + s][1]
        packed = int(0)
        for other in range(s):
            packed += 32 * rows.slices[slices + other][1]
        if packed + 32 * length > room:
            packed = int(-1)
        rows.slices[slices + s] = wp.vec2i(packed, length)
    block_barrier()
    pack_extra(env, lane, lanes, all_values[9 * first : 9 * end], rows)
