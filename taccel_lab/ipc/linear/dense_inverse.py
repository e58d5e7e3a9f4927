# SPDX-License-Identifier: Apache-2.0
"""Inverses of small dense symmetric matrices, one thread block each, in shared memory.

The sweep operator [Goodnight 1979, A tutorial on the SWEEP operator], three rows at a time and
without pivoting, which positive definite matrices do not need: the matrix stays symmetric, so that
half of it is enough, and it turns into minus its inverse in place. One row at a time, a matrix of
138 rows took 0.56 ms on an H200, with a barrier for each.
"""

# Without annotations from __future__: Warp would not find the room in that of a tile.

from functools import cache
from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})


def room_for_inverse(width: int) -> int:
    """float64 numbers of shared memory that the inverse of a matrix of so many rows needs: its
    lower triangle by rows, and two copies of three columns."""
    return width * (width + 1) // 2 + 6 * width


@cache
def address_of_tile(room: int) -> Any:
    """The function ``(tile) -> uint64`` for tiles of so many float64 numbers."""

    @wp.func_native("return reinterpret_cast<wp::uint64>(tile.data.ptr);")
    def address(tile: wp.tile(dtype=wp.float64, shape=(room,))) -> wp.uint64: ...

    return address


# A warp takes a row at a time. Whoever computes the next pivot's columns writes them to the other
# copy, so that a pivot costs one barrier.
_SWEEP_SNIPPET = """
    double* const a = reinterpret_cast<double*>(memory);
    double* columns = a + width * (width + 1) / 2;
    double* next = columns + 3 * width;
    const int step = lanes < 32 ? lanes : 32;
    const int group = lane / step;
    const int groups = lanes / step;
    const int place = lane % step;
    bool definite = true;
    WP_TILE_SYNC();
    for (int e = lane; e < 3 * width; e += lanes) {
        const int i = e / 3 > e % 3 ? e / 3 : e % 3;
        columns[e] = a[i * (i + 1) / 2 + e / 3 + e % 3 - i];
    }
    #pragma unroll 1
    for (int pivot = 0; pivot < width; pivot += 3) {
        WP_TILE_SYNC();
        // The inverse of the 3x3 block at the pivot, by its cofactors.
        const double* const d = columns + 3 * pivot;
        const double c00 = d[4] * d[8] - d[5] * d[5];
        const double c01 = d[2] * d[5] - d[1] * d[8];
        const double c02 = d[1] * d[5] - d[2] * d[4];
        const double minor = d[0] * d[4] - d[1] * d[1];
        const double det = d[0] * c00 + d[1] * c01 + d[2] * c02;
        definite = definite && d[0] > 0.0 && minor > 0.0 && det > 0.0;
        const double scale = 1.0 / det;
        const double i00 = c00 * scale, i01 = c01 * scale, i02 = c02 * scale;
        const double i11 = (d[0] * d[8] - d[2] * d[2]) * scale;
        const double i12 = (d[1] * d[2] - d[0] * d[5]) * scale;
        const double i22 = minor * scale;
        #pragma unroll 1
        for (int i = group; i < width; i += groups) {
            double* const row = a + i * (i + 1) / 2;
            const int own = i - pivot;
            const bool inside = own >= 0 && own < 3;
            // Of a row of the pivot the row of the inverse, of others minus their columns times it.
            double u0, u1, u2;
            if (inside) {
                u0 = own == 0 ? i00 : own == 1 ? i01 : i02;
                u1 = own == 0 ? i01 : own == 1 ? i11 : i12;
                u2 = own == 0 ? i02 : own == 1 ? i12 : i22;
            } else {
                const double* const c = columns + 3 * i;
                u0 = -(c[0] * i00 + c[1] * i01 + c[2] * i02);
                u1 = -(c[0] * i01 + c[1] * i11 + c[2] * i12);
                u2 = -(c[0] * i02 + c[1] * i12 + c[2] * i22);
            }
            const int after = i - pivot - 3;
            #pragma unroll 2
            for (int j = place; j <= i; j += step) {
                const int other = j - pivot;
                const double* const c = columns + 3 * j;
                double value = u0 * c[0] + u1 * c[1] + u2 * c[2];
                if (other >= 0 && other < 3)
                    value = -(other == 0 ? u0 : other == 1 ? u1 : u2);
                else if (!inside)
                    value += row[j];
                row[j] = value;
                if (after >= 0 && after < 3)
                    next[3 * j + after] = value;
                if (other >= 3 && other < 6)
                    next[3 * i + other - 3] = value;
            }
        }
        double* const swap = columns;
        columns = next;
        next = swap;
    }
    WP_TILE_SYNC();
    return definite;
"""


@wp.func_native(_SWEEP_SNIPPET)
def sweep_all(memory: wp.uint64, width: int, lane: int, lanes: int) -> bool:
    """Turn the symmetric matrix of so many rows, a multiple of three, at an address into minus its
    inverse; returns whether it is positive definite. By all lanes of a block, with a barrier before
    and after."""
    ...


@wp.func_native(
    "reinterpret_cast<double*>(memory)[row * (row + 1) / 2 + column] = value;",
)
def put_lower(memory: wp.uint64, row: int, column: int, value: wp.float64) -> None:
    """Write an entry of the lower triangle."""
    ...


@wp.func_native("""
    const int high = row > column ? row : column;
    const int low = row > column ? column : row;
    return reinterpret_cast<const double*>(memory)[high * (high + 1) / 2 + low];
""")
def get_symmetric(memory: wp.uint64, row: int, column: int) -> wp.float64:
    """Read an entry of either triangle."""
    ...
