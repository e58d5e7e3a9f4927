# SPDX-License-Identifier: Apache-2.0
"""Launches of Warp's kernels on tensors of torch, and what such kernels share."""

# Warp compiles the kernels from their source; its type stubs do not describe vectors' operators.
# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportOperatorIssue=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import warp as wp

from taccel_lab.processes.start_warp import start_warp

MIN_COVER = wp.constant(1e-3)


@wp.func_native("""
    const wp::vec_t<4, wp::float32>* from = wp::address(values, i, j, k);
#if defined(__CUDA_ARCH__)
    const float4 all = __ldg(reinterpret_cast<const float4*>(from));
    return wp::vec_t<4, wp::float32>(all.x, all.y, all.z, all.w);
#else
    return *from;
#endif
""")
def four_of(values: wp.array3d(dtype=wp.vec4), i: int, j: int, k: int) -> wp.vec4:
    """An element, in one go: of vectors Warp takes one number after another."""
    ...


def launch(kernel: Any, size: tuple[int, ...], values: Sequence[Any], lanes: int = 256) -> None:
    """Launch on the stream that torch works on, so that a graph that torch records has it."""
    start_warp()
    given = [wp.from_torch(each) if isinstance(each, torch.Tensor) else each for each in values]
    device = next(each.device for each in given if isinstance(each, wp.array))
    if not device.is_cuda:
        wp.launch(kernel, size, given, device=device)
        return
    with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream()), sync_enter=False):
        wp.launch(kernel, size, given, device=device, block_dim=lanes)


def vectors(values: torch.Tensor, dtype: Any = wp.vec4) -> Any:
    """A tensor as an array of vectors along its last axis."""
    start_warp()
    return wp.from_torch(values, dtype=dtype)


def bytes_of(flags: torch.Tensor | None, device: torch.device) -> torch.Tensor:
    """Flags [h, w] as bytes; none of none."""
    if flags is None:
        return torch.empty((0, 0), dtype=torch.uint8, device=device)
    return flags.view(torch.uint8)
