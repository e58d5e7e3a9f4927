# SPDX-License-Identifier: Apache-2.0
"""Adding up what the elements of a chunk contribute before anything is written to memory.

The lanes of a warp lay their numbers down in shared memory, one element each, and then add up
together what belongs to the same place (``element_chunks``): what leaves the warp is a quarter to a
third of it, in whole lines. Written element by element, each in lines of its own, the elastic
Hessian of 4,096 pegs took 3.6 ms on an H200, of which the arithmetic is 0.6. Which number adds to
what is read before the arithmetic, and waits beside the numbers. The CPU, where one thread is all
lanes one after the other, lays the numbers down in memory that stays in its cache, and adds them up
after the last lane.

For kernels over (environment, lane) in modules that state ``STAGED_THREADS``. All lanes of a chunk
come to the sum, also one that has no element; an environment that is at rest returns before.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.model.element_chunks import (
    CHUNK,
    EDGE_USES,
    EDGES,
    ChunkTables,
    stage_stride,
)

wp.set_module_options({"enable_backward": False})

STAGED_THREADS = 64
"""Threads of a block: two warps, of which each multiprocessor has room for six blocks on an H200,
as many as registers allow."""

NINE = native("element_parts", "nine")
"""A block of nine numbers, for snippets on the CPU."""


def _native(name: str, size: int, entries: int, uses: int) -> str:
    """A snippet for elements that lay down ``entries`` entries of ``size`` doubles, which count in
    ``uses`` sums."""
    return native(
        "chunk_stage",
        name,
        MEMORY=native("chunk_stage", "memory"),
        NINE=NINE,
        CHUNK=CHUNK,
        STRIDE=stage_stride(size, entries),
        SIZE=size,
        MOST=CHUNK * uses,
    )


# The blocks of the edges of a linear tet -------------------------------------------------------

_BLOCKS = (9, EDGES, EDGE_USES)


@wp.func_native(_native("stage", *_BLOCKS))
def stage_blocks(lane: int, tables: ChunkTables) -> wp.uint64:
    """Where the chunk of a lane lays down its numbers; what they add to is laid down already."""
    ...


@wp.func_native(_native("put", *_BLOCKS))
def put_block(stage: wp.uint64, lane: int, at: int, value: wp.mat33d) -> None:
    """Lay down entry ``at`` of the element of a lane."""
    ...


@wp.func_native(_native("sum", *_BLOCKS))
def sum_blocks(
    stage: wp.uint64,
    env: int,
    lane: int,
    tables: ChunkTables,
    sums: wp.array2d(dtype=wp.mat33d),
) -> None:
    """Write the sums of the chunk of a lane; those of all chunks are [env_count, sum_count]."""
    ...


# Its four nodal forces -------------------------------------------------------------------------

_FORCES = (3, 4, 4)


@wp.func_native(_native("stage", *_FORCES))
def stage_forces(lane: int, tables: ChunkTables) -> wp.uint64:
    """See ``stage_blocks``."""
    ...


@wp.func_native(_native("put", *_FORCES))
def put_force(stage: wp.uint64, lane: int, at: int, value: wp.vec3d) -> None:
    """See ``put_block``."""
    ...


@wp.func_native(_native("sum", *_FORCES))
def sum_forces(
    stage: wp.uint64,
    env: int,
    lane: int,
    tables: ChunkTables,
    sums: wp.array2d(dtype=wp.vec3d),
) -> None:
    """See ``sum_blocks``."""
    ...
