# SPDX-License-Identifier: Apache-2.0
"""Launches over lists whose length only the device knows.

A fixed number of lanes an environment takes the entries in turn, so that a launch neither depends
on a count that the host would have to read, nor on the capacity of the list: it can be part of a
captured graph, and lists may grow. The CPU, which runs threads one after the other, has one lane.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import warp as wp

WARP_THREADS = 32
"""Threads of a block where there are few, with much to do each, such as one an affine body: blocks
of a warp spread over the multiprocessors of a GPU, of which 256 bodies in one block keep one busy.
"""
_THREADS = 1 << 18
"""Threads that keep a large GPU busy."""


def lane_count(device: wp.Device, env_count: int, room: int) -> int:
    """Lanes an environment for lists with room for so many entries where there is most."""
    if device.is_cpu:
        return 1
    return max(1, min(room, max(32, _THREADS // env_count)))


def launch(
    kernel: wp.Kernel,
    dim: int | Sequence[int],
    inputs: Sequence[Any],
    outputs: Sequence[Any] = (),
    *,
    device: wp.Device,
) -> None:
    """``wp.launch`` in blocks of the size that the kernel's module states (its option
    ``block_dim``), which is what it is compiled for; ``wp.launch`` alone takes 256 threads and
    compiles the module anew for them, whatever the option says."""
    wp.launch(
        kernel,
        dim=dim,
        inputs=list(inputs),
        outputs=list(outputs),
        device=device,
        block_dim=kernel.module.options["block_dim"],
    )
