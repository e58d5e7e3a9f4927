# SPDX-License-Identifier: Apache-2.0
"""Turns of threads: one thread at a time speaks to Warp, others while it waits for its device.

Warp keeps the current stream of a device, and a capture that is under way, once for the process.
A thread that launches while another one captures has its kernels recorded instead of run; one that
switches streams takes the other's launches along. So what launches here does it ``in_turn``, and a
step lets others have their turn while its device is at work. A program with one thread pays for
taking a lock that nobody holds.

Kernels that a user launches from another thread need a turn as well: ``with TURNS: ...``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from threading import RLock, get_ident
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

import warp as wp

P = ParamSpec("P")
T = TypeVar("T")


class Turns:
    """A lock that the thread which holds it may take again.

    On a GPU the current stream stays the same within a turn. When it begins the stream waits for
    torch's current one, and torch's for it when it ends. Once several threads have had turns, one
    ends when its stream is through: a thread may find another stream to be current afterwards.
    """

    def __init__(self) -> None:
        self._lock = RLock()
        self._depth = 0
        self._threads: set[int] = set()
        self._devices: list[wp.Device] = []
        self._streams: dict[tuple[str, int], wp.Stream] = {}

    def watch(self, device: wp.Device) -> None:
        """Keep the current stream of a device as it is within turns."""
        if device.is_cuda and device not in self._devices:
            set_stream = device.set_stream

            @wraps(set_stream)
            def in_turn_only(stream: wp.Stream, sync: bool = True) -> None:
                with self._lock:
                    set_stream(stream, sync)

            device.set_stream = in_turn_only
            self._devices.append(device)

    def __enter__(self) -> Turns:
        self._lock.acquire()
        self._depth += 1
        if self._depth == 1:
            self._threads.add(get_ident())
            self._meet_torch(lambda ours, theirs: ours.wait_stream(theirs))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if self._depth == 1 and kind is None:
                self._meet_torch(lambda ours, theirs: theirs.wait_stream(ours))
                if len(self._threads) > 1:
                    for device in self._devices:
                        if not device.stream.is_capturing:
                            wp.synchronize_stream(device.stream)
        finally:
            self._depth -= 1
            self._lock.release()

    def wait_for(self, device: wp.Device) -> None:
        """Wait until the current stream of ``device`` is through; others have their turn until
        then. Afterwards the stream is current again."""
        if not device.is_cuda:
            return
        depth, stream = self._depth, device.stream
        self._depth = 0
        for _ in range(depth):
            self._lock.release()
        try:
            wp.synchronize_stream(stream)
        finally:
            for _ in range(depth):
                self._lock.acquire()
            self._depth = depth
            if device.stream is not stream:
                device.set_stream(stream, False)

    def _meet_torch(self, wait: Callable[[wp.Stream, wp.Stream], None]) -> None:
        """Have one of two streams wait for the other where torch's current one is another one."""
        torch: Any = sys.modules.get("torch")
        if not self._devices or torch is None or not torch.cuda.is_initialized():
            return
        for device in self._devices:
            theirs = torch.cuda.current_stream(device.ordinal)
            # Streams of Warp and torch's usual one, which is 0, wait for each other by themselves.
            if theirs.cuda_stream not in (0, device.stream.cuda_stream):
                if not (device.stream.is_capturing or torch.cuda.is_current_stream_capturing()):
                    wait(device.stream, self._known(device, theirs.cuda_stream))

    def _known(self, device: wp.Device, handle: int) -> wp.Stream:
        """A stream of torch's, which has few and never destroys them. Warp must not make or drop
        one while another thread does."""
        key = (device.alias, handle)
        if key not in self._streams:
            self._streams[key] = wp.Stream(device, cuda_stream=handle)
        return self._streams[key]


TURNS = Turns()
"""Of this process."""


def in_turn(function: Callable[P, T]) -> Callable[P, T]:
    """The function, run when it is this thread's turn."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        with TURNS:
            return function(*args, **kwargs)

    return run
