# SPDX-License-Identifier: Apache-2.0
"""Adding up what the elements of a chunk contribute before anything is written to memory.

The lanes of a warp lay their numbers down in shared memory, one element each, and then add up
together what belongs to the same place (``element_chunks``): what leaves the warp is a quarter to a
third of it, in whole lines. Written element by element, each in lines of its own, the elastic
Hessian of 4,096 pegs took 3.6 ms on an H200, of which the arithmetic is 0.6. The CPU, where one
thread is all lanes one after the other, lays the numbers down in memory that stays in its cache,
and adds them up after the last lane.

For kernels over (environment, lane) in modules that state ``STAGED_THREADS``. All lanes of a chunk
come to the sum, also one that has no element; an environment that is at rest returns before.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.model.element_chunks import CHUNK, ChunkTables, stage_stride

wp.set_module_options({"enable_backward": False})

STAGED_THREADS = 64
"""Threads of a block: two warps with 90 numbers a thread fill the 48 KiB that every GPU has."""

_STAGE_SNIPPET = native("chunk_stage", "stage")
_PUT_SNIPPET = native("chunk_stage", "put")
_SUM_SNIPPET = native("chunk_stage", "sum")


def _filled(snippet: str, size: int, entries: int) -> str:
    """A snippet for elements that contribute ``entries`` entries of ``size`` doubles."""
    for name, number in (
        ("CHUNK", CHUNK),
        ("STRIDE", stage_stride(size, entries)),
        ("SIZE", size),
    ):
        snippet = snippet.replace(f"@{name}@", str(number))
    return snippet


# The ten blocks of a linear tet ---------------------------------------------------------------


@wp.func_native(_filled(_STAGE_SNIPPET, 9, 10))
def stage_blocks() -> wp.uint64:
    """Where a chunk lays down its numbers."""
    ...


@wp.func_native(_filled(_PUT_SNIPPET, 9, 10))
def put_block(stage: wp.uint64, lane: int, at: int, value: wp.mat33d) -> None:
    """Lay down entry ``at`` of the element of a lane."""
    ...


@wp.func_native(_filled(_SUM_SNIPPET, 9, 10))
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


@wp.func_native(_filled(_STAGE_SNIPPET, 3, 4))
def stage_forces() -> wp.uint64:
    """See ``stage_blocks``."""
    ...


@wp.func_native(_filled(_PUT_SNIPPET, 3, 4))
def put_force(stage: wp.uint64, lane: int, at: int, value: wp.vec3d) -> None:
    """See ``put_block``."""
    ...


@wp.func_native(_filled(_SUM_SNIPPET, 3, 4))
def sum_forces(
    stage: wp.uint64,
    env: int,
    lane: int,
    tables: ChunkTables,
    sums: wp.array2d(dtype=wp.vec3d),
) -> None:
    """See ``sum_blocks``."""
    ...
