# SPDX-License-Identifier: Apache-2.0
"""Writing what each thread has many numbers of, so that a GPU's memory sees whole lines.

A thread an element that writes its 90 numbers one after the other touches a line of memory of its
own each time, and a warp 32 of them: on an H200 that took the elastic Hessian of 4,096 pegs 3.6 ms,
of which the arithmetic is 0.6. Here the threads of a warp lay their numbers down in shared memory
and write the rows together, in the order in which they lie. The CPU writes them at once.

For kernels over (environment, item) that are launched with ``STAGED_THREADS`` and whose threads all
come to the flush, one that has nothing to write too.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

STAGED_THREADS = 64
"""Threads of a block: two warps with 90 numbers a thread fill the 48 KiB that every GPU has."""

_STAGE_SNIPPET = """
#if defined(__CUDA_ARCH__)
    // An odd stride: the threads of a warp write to different banks.
    __shared__ double numbers[@WARPS@][32 * @STRIDE@];
    return reinterpret_cast<wp::uint64>(numbers[threadIdx.x >> 5]);
#else
    return 0;
#endif
"""
_PUT_SNIPPET = """
    const double* const from = reinterpret_cast<const double*>(&value);
#if defined(__CUDA_ARCH__)
    double* const to = reinterpret_cast<double*>(stage) + (threadIdx.x & 31) * @STRIDE@;
#else
    double* const to = reinterpret_cast<double*>(rows.data) + size_t(item) * @WIDTH@;
#endif
    for (int i = 0; i < @SIZE@; ++i)
        to[@SIZE@ * at + i] = from[i];
"""
_FLUSH_SNIPPET = """
#if defined(__CUDA_ARCH__)
    const int lane = threadIdx.x & 31;
    const int first = item - lane;
    const int left = rows.shape[0] * rows.shape[1] - first;
    const int count = left < 32 ? left : 32;
    const unsigned all = count == 32 ? 0xffffffffu : (1u << count) - 1u;
    __syncwarp(all);
    const unsigned writing = __ballot_sync(all, writes);
    if (writing == 0u)
        return;
    const double* const from = reinterpret_cast<const double*>(stage);
    double* const to = reinterpret_cast<double*>(rows.data) + size_t(first) * @WIDTH@;
    for (int i = lane; i < count * @WIDTH@; i += count) {
        const int row = i / @WIDTH@;
        if (writing >> row & 1u)
            to[i] = from[row * @STRIDE@ + i - row * @WIDTH@];
    }
    __syncwarp(all);
#endif
"""


def _filled(snippet: str, size: int, entries: int) -> str:
    """A snippet for rows of so many entries of ``size`` doubles."""
    width = size * entries
    for name, number in (
        ("WARPS", STAGED_THREADS // 32),
        ("STRIDE", width | 1),
        ("WIDTH", width),
        ("SIZE", size),
    ):
        snippet = snippet.replace(f"@{name}@", str(number))
    return snippet


# The blocks of a linear tet, mat33d, [env_count, tet_count, 10] -----------------------------------


@wp.func_native(_filled(_STAGE_SNIPPET, 9, 10))
def stage_blocks() -> wp.uint64:
    """Where a warp lays down its rows."""
    ...


@wp.func_native(_filled(_PUT_SNIPPET, 9, 10))
def put_block(
    stage: wp.uint64, rows: wp.array3d(dtype=wp.mat33d), item: int, at: int, value: wp.mat33d
) -> None:
    """Entry ``at`` of the thread's row, which is the ``item``-th of all rows."""
    ...


@wp.func_native(_filled(_FLUSH_SNIPPET, 9, 10))
def flush_blocks(
    stage: wp.uint64, rows: wp.array3d(dtype=wp.mat33d), item: int, writes: bool
) -> None:
    """Write the rows of those threads of the warp that want to."""
    ...


# Its nodal forces, vec3d, [env_count, tet_count, 4] -----------------------------------------------


@wp.func_native(_filled(_STAGE_SNIPPET, 3, 4))
def stage_forces() -> wp.uint64:
    """See ``stage_blocks``."""
    ...


@wp.func_native(_filled(_PUT_SNIPPET, 3, 4))
def put_force(
    stage: wp.uint64, rows: wp.array3d(dtype=wp.vec3d), item: int, at: int, value: wp.vec3d
) -> None:
    """See ``put_block``."""
    ...


@wp.func_native(_filled(_FLUSH_SNIPPET, 3, 4))
def flush_forces(
    stage: wp.uint64, rows: wp.array3d(dtype=wp.vec3d), item: int, writes: bool
) -> None:
    """See ``flush_blocks``."""
    ...
