# SPDX-License-Identifier: Apache-2.0
"""Inverses of small dense symmetric matrices, one thread block each, in shared memory.

The sweep operator [Goodnight 1979, A tutorial on the SWEEP operator], three rows at a time and
without pivoting, which positive definite matrices do not need: the matrix stays symmetric, so that
half of it is enough, and it turns into minus its inverse in place. A matrix of 138 rows took
0.56 ms on an H200 with one row at a time, and 0.22 ms with the matrix in shared memory.
"""

# Without annotations from __future__: Warp would not find the room in that of a tile.

from functools import cache
from typing import Any

import warp as wp

from taccel_lab.ipc.device.native import native

wp.set_module_options({"enable_backward": False})


MOST_ROWS = 144
"""Rows of the largest matrix."""
MOST_TILES = (MOST_ROWS // 6) * (MOST_ROWS // 6 + 1) // 2
"""Tiles of its lower triangle, 6x6 each."""


def lanes_for_inverse(width: int) -> int:
    """Lanes that a thread block of a GPU needs for a matrix of ``width`` rows, one a tile."""
    parts = -(-width // 6)
    return -(-parts * (parts + 1) // 2 // 32) * 32


def room_for_inverse(width: int) -> int:
    """float64 numbers of shared memory that the inverse of a matrix of ``width`` rows
    needs: its lower triangle by rows, and two copies of three columns. ValueError above
    ``MOST_ROWS``."""
    if width > MOST_ROWS:
        raise ValueError(f"matrices of at most {MOST_ROWS} rows are inverted, got {width}")
    return width * (width + 1) // 2 + 6 * width


@cache
def address_of_tile(room: int) -> Any:
    """The function ``(tile) -> uint64`` for tiles of ``room`` float64 numbers."""

    @wp.func_native("return reinterpret_cast<wp::uint64>(tile.data.ptr);")
    def address(tile: wp.tile(dtype=wp.float64, shape=(room,))) -> wp.uint64: ...

    return address


@wp.func_native(native("dense_inverse", "sweep_all", MOST_TILES=MOST_TILES))
def sweep_all(memory: wp.uint64, width: int, lane: int, lanes: int) -> bool:
    """Turn the symmetric matrix of ``width`` rows, a multiple of three, at an address into minus
    its inverse; returns whether it is positive definite. By all lanes of a block, with a barrier
    before and after; on a GPU by ``lanes_for_inverse`` of them or more."""
    ...


@wp.func_native(
    "reinterpret_cast<double*>(memory)[row * (row + 1) / 2 + column] = value;",
)
def put_lower(memory: wp.uint64, row: int, column: int, value: wp.float64) -> None:
    """Write an entry of the lower triangle."""
    ...


@wp.func_native(native("dense_inverse", "get_symmetric"))
def get_symmetric(memory: wp.uint64, row: int, column: int) -> wp.float64:
    """Read an entry of either triangle."""
    ...
