# SPDX-License-Identifier: Apache-2.0
"""Work that may run side by side: parallel branches of a captured graph.

A small scene keeps a few multiprocessors of a GPU busy, and its time is the sum of the latencies of
its kernels; those that do not wait for each other's results need not wait at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp

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
