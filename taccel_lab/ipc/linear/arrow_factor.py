# SPDX-License-Identifier: Apache-2.0
"""Numeric block Cholesky factorisation in block-arrow form by one thread block, and its solves.

Level by level: all blocks of the level subtract their pairs, then lanes factor the diagonal blocks
and scale what lies below. The border among itself is a small dense matrix, the Schur complement,
which is inverted. Extra blocks between two gel rows have no place in the factor and are left out.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.linear.block_ops import block_barrier
from taccel_lab.ipc.linear.extra_rows import ExtraRows
from taccel_lab.ipc.linear.preconditioner import sweep

wp.set_module_options({"enable_backward": False})

SUM_CHUNKS = 32
"""Partial sums of a border row."""
SCHUR_CHUNKS = 4
"""Partial sums of an element of the Schur complement."""


@wp.struct
class ArrowLists:
    """``Elimination`` on the device; what it calls n columns, m border rows.

    starts, columns, codes, pair_starts, pairs, level_starts, level_columns, row_starts,
    row_entries, column_starts, column_entries: as there.
    border_codes: blocks of the pattern of the border among itself, row by row, [m m].
    border_places: number in the border of each row of the system, or -1, [n + m].
    places: place of each row of the system, those of the border last, [n + m].
    border_count: m.
    """

    starts: wp.array(dtype=wp.int32)
    columns: wp.array(dtype=wp.int32)
    codes: wp.array(dtype=wp.int32)
    pair_starts: wp.array(dtype=wp.int32)
    pairs: wp.array(dtype=wp.vec2i)
    level_starts: wp.array(dtype=wp.int32)
    level_columns: wp.array(dtype=wp.int32)
    row_starts: wp.array(dtype=wp.int32)
    row_entries: wp.array(dtype=wp.vec2i)
    column_starts: wp.array(dtype=wp.int32)
    column_entries: wp.array(dtype=wp.vec2i)
    border_codes: wp.array(dtype=wp.int32)
    border_places: wp.array(dtype=wp.int32)
    places: wp.array(dtype=wp.int32)
    border_count: int


@wp.func
def _component(code: int, i: int, j: int) -> int:
    """Where element (i, j) of a coded block is among the scalars of the pattern's blocks."""
    if code & 1:
        return 9 * (code >> 1) + 3 * j + i
    return 9 * (code >> 1) + 3 * i + j


@wp.func
def load_matrix(
    env: int,
    lane: int,
    lanes: int,
    lists: ArrowLists,
    values: wp.array(dtype=wp.float64),
    extra: ExtraRows,
    extra_places: wp.array(dtype=wp.vec2i),
    extra_values: wp.array(dtype=wp.float64),
    factor: wp.array(dtype=wp.float64),
):
    """Blocks of the matrix at their places in the factor, without the border among itself."""
    for e in range(lane, factor.shape[0], lanes):
        code = lists.codes[e / 9]
        value = wp.float64(0.0)
        if code >= 0:
            value = values[_component(code, e % 9 / 3, e % 3)]
        factor[e] = value
    block_barrier()
    first = extra.starts[env][0]
    for e in range(lane, 9 * extra.totals[env, 0], lanes):
        code = extra.codes[2 * first + e / 9]
        k = first + code / 2
        i = extra_places[k][0]
        j = extra_places[k][1]
        # Every block is listed twice: here as that of a border row and a gel column.
        if code & 1:
            swap = i
            i = j
            j = swap
        c = lists.border_places[i]
        if c >= 0 and lists.border_places[j] < 0:
            at = 9 * (lists.starts[lists.places[j]] + 1 + c) + e % 9
            factor[at] += extra_values[9 * first + _component(code, e % 9 / 3, e % 3)]


@wp.func
def _inverse_root(a: wp.array(dtype=wp.float64), at: int) -> wp.mat33d:
    """Inverse of the lower Cholesky factor of the 3x3 block at ``at``; NaN where it has none."""
    one = wp.float64(1.0)
    r00 = one / wp.sqrt(a[at])
    l10 = a[at + 3] * r00
    l20 = a[at + 6] * r00
    r11 = one / wp.sqrt(a[at + 4] - l10 * l10)
    l21 = (a[at + 7] - l20 * l10) * r11
    r22 = one / wp.sqrt(a[at + 8] - l20 * l20 - l21 * l21)
    r10 = -l10 * r00 * r11
    r20 = -(l20 * r00 + l21 * r10) * r22
    zero = wp.float64(0.0)
    return wp.mat33d(r00, zero, zero, r10, r11, zero, r20, -l21 * r11 * r22, r22)


# Written out in C++: arrays of Warp carry strides, which cost registers and multiplications here.
_PAIRS_SNIPPET = """
    const wp::vec_t<2, wp::int32>* pair = pairs.data;
    const wp::float64* blocks = factor.data;
    wp::float64 total = 0.0;
    #pragma unroll 2
    for (int e = first; e < end; ++e) {
        const wp::float64* a = blocks + 9 * pair[e][0] + row;
        const wp::float64* b = blocks + 9 * pair[e][1] + column;
        total += a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    }
    return total;
"""


@wp.func_native(_PAIRS_SNIPPET)
def _pair_sum(
    first: int,
    end: int,
    row: int,
    column: int,
    pairs: wp.array(dtype=wp.vec2i),
    factor: wp.array(dtype=wp.float64),
) -> wp.float64:
    """Sum of an element of a b^T over pairs; ``row`` and ``column`` start rows of a and b."""
    ...


_ROW_SNIPPET = """
    const wp::vec_t<2, wp::int32>* entry = entries.data;
    wp::vec_t<3, wp::float64> total;
    #pragma unroll 2
    for (int e = first; e < end; ++e) {
        const wp::float64* a = factor.data + 9 * entry[e][0];
        const wp::float64* y = z.data + 3 * entry[e][1];
        const int across = flipped ? 3 : 1;
        const int down = flipped ? 1 : 3;
        total[0] += a[0] * y[0] + a[across] * y[1] + a[2 * across] * y[2];
        a += down;
        total[1] += a[0] * y[0] + a[across] * y[1] + a[2 * across] * y[2];
        a += down;
        total[2] += a[0] * y[0] + a[across] * y[1] + a[2 * across] * y[2];
    }
    return total;
"""


@wp.func_native(_ROW_SNIPPET)
def _entry_sum(
    first: int,
    end: int,
    flipped: int,
    entries: wp.array(dtype=wp.vec2i),
    factor: wp.array(dtype=wp.float64),
    z: wp.array(dtype=wp.float64),
) -> wp.vec3d:
    """Sum of L z over the entries (block, place) of a row, of L^T z over those of a column."""
    ...


@wp.func
def factor_columns(
    lane: int,
    lanes: int,
    lists: ArrowLists,
    factor: wp.array(dtype=wp.float64),
    roots: wp.array(dtype=wp.mat33d),
):
    """Factor all columns; ``roots`` receives the inverses of the diagonal blocks of the factor."""
    for level in range(lists.level_starts.shape[0] - 1):
        first = lists.level_starts[level]
        end = lists.level_starts[level + 1]
        block_barrier()
        for task in range(9 * first + lane, 9 * end, lanes):
            block = task / 9
            begin = lists.pair_starts[block]
            stop = lists.pair_starts[block + 1]
            if stop > begin:
                # Element (i, j) is that of row i of a and row j of b.
                i = 3 * (task % 9 / 3)
                j = 3 * (task % 3)
                factor[task] -= _pair_sum(begin, stop, i, j, lists.pairs, factor)
        block_barrier()
        for task in range(3 * first + lane, 3 * end, lanes):
            block = task / 3
            column = lists.columns[block]
            diagonal = lists.starts[column]
            root = _inverse_root(factor, 9 * diagonal)
            if block == diagonal:
                if task % 3 == 0:
                    roots[column] = root
            else:
                at = 3 * task
                row = root * wp.vec3d(factor[at], factor[at + 1], factor[at + 2])
                factor[at] = row[0]
                factor[at + 1] = row[1]
                factor[at + 2] = row[2]
    block_barrier()


@wp.func
def invert_schur(
    env: int,
    lane: int,
    lanes: int,
    lists: ArrowLists,
    values: wp.array(dtype=wp.float64),
    extra: ExtraRows,
    extra_places: wp.array(dtype=wp.vec2i),
    extra_values: wp.array(dtype=wp.float64),
    factor: wp.array(dtype=wp.float64),
    sums: wp.array(dtype=wp.float64),
    schur: wp.array(dtype=wp.float64),
):
    """Inverse of the border's Schur complement, in the second half of ``schur``."""
    width = 3 * lists.border_count
    size = width * width
    chunks = int(SCHUR_CHUNKS)
    for task in range(lane, chunks * size, lanes):
        e = task / chunks
        i = e / width
        j = e % width
        total = wp.float64(0.0)
        for column in range(task % chunks, lists.starts.shape[0], chunks):
            first = 9 * (lists.starts[column] + 1)
            a = first + 3 * i
            b = first + 3 * j
            total += factor[a] * factor[b]
            total += factor[a + 1] * factor[b + 1]
            total += factor[a + 2] * factor[b + 2]
        sums[task] = total
    block_barrier()
    old = (width + 1) % 2 * size
    for e in range(lane, size, lanes):
        i = e / width
        j = e % width
        code = lists.border_codes[i / 3 * lists.border_count + j / 3]
        value = wp.float64(0.0)
        if code >= 0:
            value = values[_component(code, i % 3, j % 3)]
        for chunk in range(chunks):
            value -= sums[e * chunks + chunk]
        schur[old + e] = value
    block_barrier()
    start = extra.starts[env][0]
    for e in range(lane, 9 * extra.totals[env, 0], lanes):
        code = extra.codes[2 * start + e / 9]
        i = lists.border_places[extra_places[start + code / 2][0]]
        j = lists.border_places[extra_places[start + code / 2][1]]
        if i >= 0 and j >= 0:
            if code & 1:
                swap = i
                i = j
                j = swap
            at = (3 * i + e % 9 / 3) * width + 3 * j + e % 3
            schur[old + at] += extra_values[9 * start + _component(code, e % 9 / 3, e % 3)]
    new = size - old
    for pivot in range(width):
        block_barrier()
        sweep(lane, lanes, width, pivot, old, new, schur)
        swap_copy = old
        old = new
        new = swap_copy


@wp.func
def _solve_border(
    lane: int,
    lanes: int,
    lists: ArrowLists,
    factor: wp.array(dtype=wp.float64),
    sums: wp.array(dtype=wp.float64),
    schur: wp.array(dtype=wp.float64),
    r: wp.array(dtype=wp.float64),
    z: wp.array(dtype=wp.float64),
):
    """Border rows of z from its gel rows y; y less what the border takes from them."""
    n = lists.starts.shape[0]
    width = 3 * lists.border_count
    chunks = int(SUM_CHUNKS)
    for task in range(lane, chunks * width, lanes):
        i = task / chunks
        total = wp.float64(0.0)
        for column in range(task % chunks, n, chunks):
            a = 9 * (lists.starts[column] + 1) + 3 * i
            total += factor[a] * z[3 * column]
            total += factor[a + 1] * z[3 * column + 1]
            total += factor[a + 2] * z[3 * column + 2]
        sums[task] = total
    block_barrier()
    for i in range(lane, width, lanes):
        total = r[3 * n + i]
        for chunk in range(chunks):
            total -= sums[i * chunks + chunk]
        # Its own place in sums: no other lane reads that.
        sums[i * chunks] = total
    block_barrier()
    for i in range(lane, width, lanes):
        total = wp.float64(0.0)
        for k in range(width):
            # Down a column of the symmetric inverse.
            total += schur[width * width + width * k + i] * sums[k * chunks]
        z[3 * n + i] = total
    block_barrier()
    for task in range(lane, 3 * n, lanes):
        column = task / 3
        at = 9 * (lists.starts[column] + 1) + task % 3
        total = z[task]
        for k in range(width):
            total -= factor[at + 3 * k] * z[3 * n + k]
        z[task] = total
    block_barrier()


@wp.func
def solve_factored(
    lane: int,
    lanes: int,
    lists: ArrowLists,
    factor: wp.array(dtype=wp.float64),
    roots: wp.array(dtype=wp.mat33d),
    sums: wp.array(dtype=wp.float64),
    schur: wp.array(dtype=wp.float64),
    r: wp.array(dtype=wp.vec3d),
    r_scalars: wp.array(dtype=wp.float64),
    z: wp.array(dtype=wp.vec3d),
    z_scalars: wp.array(dtype=wp.float64),
):
    """z = (factored matrix)^-1 r, by places."""
    level_count = lists.level_columns.shape[0] - 1
    for level in range(level_count):
        for row in range(lists.level_columns[level] + lane, lists.level_columns[level + 1], lanes):
            begin = lists.row_starts[row]
            end = lists.row_starts[row + 1]
            total = r[row] - _entry_sum(begin, end, 0, lists.row_entries, factor, z_scalars)
            z[row] = roots[row] * total
        block_barrier()
    if lists.border_count > 0:
        _solve_border(lane, lanes, lists, factor, sums, schur, r_scalars, z_scalars)
    for back in range(level_count):
        level = level_count - 1 - back
        for row in range(lists.level_columns[level] + lane, lists.level_columns[level + 1], lanes):
            begin = lists.column_starts[row]
            end = lists.column_starts[row + 1]
            total = z[row] - _entry_sum(begin, end, 1, lists.column_entries, factor, z_scalars)
            # v * M = M^T v
            z[row] = total * roots[row]
        block_barrier()
