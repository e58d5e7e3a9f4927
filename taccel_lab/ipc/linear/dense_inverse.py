# SPDX-License-Identifier: Apache-2.0
"""Inverses of small dense symmetric matrices, one thread block each, in shared memory.

The sweep operator [Goodnight 1979, A tutorial on the SWEEP operator], pivot by pivot and without
pivoting, which positive definite matrices do not need: the matrix stays symmetric, so that half of
it is enough, and it turns into minus its inverse in place. In global memory each pivot would read
and write the whole matrix there: 100 clusters of 16 nodes in 64 environments took 2.7 ms on an
H200, a quarter of a Newton iteration.
"""

# Without annotations from __future__: Warp would not find the room in that of a tile.

from functools import cache
from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})


def room_for_inverse(width: int) -> int:
    """float64 numbers of shared memory that the inverse of a matrix of so many rows needs: its
    lower triangle by rows, and two copies of a column."""
    return width * (width + 1) // 2 + 2 * width


@cache
def address_of_tile(room: int) -> Any:
    """The function ``(tile) -> uint64`` for tiles of so many float64 numbers."""

    @wp.func_native("return reinterpret_cast<wp::uint64>(tile.data.ptr);")
    def address(tile: wp.tile(dtype=wp.float64, shape=(room,))) -> wp.uint64: ...

    return address


# A warp takes a row at a time. Whoever computes the next pivot's column writes it to the other
# copy, so that a pivot costs one barrier.
_SWEEP_SNIPPET = """
    double* const a = reinterpret_cast<double*>(memory);
    double* column = a + width * (width + 1) / 2;
    double* next = column + width;
    const int step = lanes < 32 ? lanes : 32;
    const int group = lane / step;
    const int groups = lanes / step;
    const int place = lane % step;
    bool definite = true;
    WP_TILE_SYNC();
    for (int i = lane; i < width; i += lanes)
        column[i] = a[i * (i + 1) / 2];
    #pragma unroll 1
    for (int pivot = 0; pivot < width; ++pivot) {
        WP_TILE_SYNC();
        definite = definite && column[pivot] > 0.0;
        const double inverse = 1.0 / column[pivot];
        #pragma unroll 1
        for (int i = group; i < width; i += groups) {
            double* const row = a + i * (i + 1) / 2;
            if (i == pivot) {
                for (int j = place; j <= i; j += step)
                    row[j] = j == pivot ? -inverse : column[j] * inverse;
                continue;
            }
            const double across = column[i] * inverse;
            for (int j = place; j <= i; j += step) {
                const double value = j == pivot ? across : row[j] - across * column[j];
                row[j] = value;
                if (i == pivot + 1)
                    next[j] = value;
                else if (j == pivot + 1)
                    next[i] = value;
            }
        }
        double* const swap = column;
        column = next;
        next = swap;
    }
    WP_TILE_SYNC();
    return definite;
"""


@wp.func_native(_SWEEP_SNIPPET)
def sweep_all(memory: wp.uint64, width: int, lane: int, lanes: int) -> bool:
    """Turn the symmetric matrix of so many rows at an address into minus its inverse; returns
    whether it is positive definite. By all lanes of a block, with a barrier before and after."""
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
