# SPDX-License-Identifier: Apache-2.0
"""How work is launched: over lists of unknown length, side by side, in shared memory.

Launches over lists whose length only the device knows.

A fixed number of lanes an environment takes the entries in turn, so that a launch neither depends
on a count that the host would have to read, nor on the capacity of the list: it can be part of a
captured graph, and lists may grow. The CPU, which runs threads one after the other, has one lane.

Work that may run side by side: parallel branches of a captured graph.

A small scene keeps a few multiprocessors of a GPU busy, and its time is the sum of the latencies of
its kernels; those that do not wait for each other's results need not wait at all.

Memory that several parts use in turn.

The blocks of the elements are among the largest that an environment needs, and they are idle once
they are gathered: the linear solver keeps in the same place what it needs during a solve alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import warp as wp

WARP_THREADS = 32
"""Threads of a block where there are few, with much to do each, such as one an affine body: blocks
of a warp spread over the multiprocessors of a GPU, of which 256 bodies in one block keep one busy.
"""


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


_MOST = 6
"""Branches beside the first."""


class Branches:
    """Streams of a device; on the CPU the parts run one after the other."""

    def __init__(self, device: wp.Device) -> None:
        self._device = device
        self._streams: list[wp.Stream] = []
        self._done: list[wp.Event] = []
        if device.is_cuda:
            self._streams = [wp.Stream(device) for _ in range(_MOST)]
            self._done = [wp.Event(device) for _ in range(_MOST)]
            self._fork = wp.Event(device)

    def run(self, parts: Sequence[Callable[[], None]]) -> None:
        """Run all parts, none of which may write what another one reads or writes (other than by
        atomics), and go on when all are done."""
        if not self._streams or len(parts) < 2:
            for part in parts:
                part()
            return
        main = self._device.stream
        main.record_event(self._fork)
        for i, part in enumerate(parts[1:]):
            side = self._streams[i % _MOST]
            if i < _MOST:
                side.wait_event(self._fork)
            with wp.ScopedStream(side, sync_enter=False):
                part()
        parts[0]()
        for i in range(min(len(parts) - 1, _MOST)):
            self._streams[i].record_event(self._done[i])
            main.wait_event(self._done[i])


_OF_DEVICE: dict[str, Branches] = {}


def side_by_side(device: wp.Device, parts: Sequence[Callable[[], None]]) -> None:
    """``Branches.run`` with the streams of a device."""
    if device.alias not in _OF_DEVICE:
        _OF_DEVICE[device.alias] = Branches(device)
    _OF_DEVICE[device.alias].run(parts)


_ALIGNMENT = 256


class Scratch:
    """Hands out parts of an array as others; what does not fit is allocated."""

    def __init__(self, owner: wp.array | None = None) -> None:
        """``owner``: the memory to share; without one everything is allocated."""
        self._owner = owner
        self._used = 0

    def take(self, shape: tuple[int, ...], dtype: type, device: wp.Device) -> wp.array:
        """An array whose contents last until the owner, or who else shares it, is written."""
        size = math.prod(shape) * wp.types.type_size_in_bytes(dtype)
        if self._owner is None or self._used + size > self._owner.capacity:
            return wp.zeros(shape, dtype=dtype, device=device)
        pointer = self._owner.ptr + self._used
        self._used += -(-size // _ALIGNMENT) * _ALIGNMENT
        part = wp.array(ptr=pointer, dtype=dtype, shape=shape, device=device)
        # Keeps the memory alive.
        part._ref = self._owner
        return part
