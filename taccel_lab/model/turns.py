# SPDX-License-Identifier: Apache-2.0
"""Turns of threads: one thread at a time speaks to Warp, others while it waits for its device.

Warp keeps the current stream of a device, and a capture that is under way, once for the process.
A thread that launches while another one captures has its kernels recorded instead of run; one that
switches streams takes the other's launches along. So what launches here does it ``in_turn``, a step
lets others have their turn while its device is at work, and each thread has a current stream of its
own, as in torch. A program with one thread pays for taking a lock that nobody holds.

What a user makes or launches in another thread needs a turn as well: ``with TURNS: ...``.

Why ``stream`` and ``set_stream`` of Warp's class of devices are replaced, and nothing else of Warp:

- Warp asks ``device.stream`` at every launch, copy and capture. A lock alone does not do: two
  threads that each chose a stream would, turn by turn, launch on that which was chosen last.
- A subclass does not do either: Warp makes its devices when it starts, and hands them out by name.
- With one thread both answer as Warp's own do; a device that nobody watches is left alone.

Upstream would have to offer two things to make this file go: a current stream for each thread, as
``torch.cuda.current_stream`` has, and captures that record what their own thread launches. What
would stay is the order between Warp's streams and torch's.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from functools import cache, wraps
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

import warp as wp

P = ParamSpec("P")
T = TypeVar("T")


_MINE = threading.local()
"""Current streams of this thread, by alias of the device."""


@cache
def _give_threads_streams(kind: Any) -> None:
    """Make the current stream of Warp's class of devices that of the thread. Below it, where arrays
    are made and dropped, Warp knows one: that of the thread whose turn it is."""
    of_warp, set_of_warp = kind.stream.fget, kind.set_stream

    def stream(self: wp.Device) -> wp.Stream:
        usual = TURNS.default_streams.get(self.alias)
        return getattr(_MINE, self.alias, usual) or of_warp(self)

    @wraps(set_of_warp)
    def set_stream(self: wp.Device, stream: wp.Stream, sync: bool = True) -> None:
        with TURNS.lock:
            if sync and stream is not self.stream:
                stream.wait_stream(self.stream)
            set_of_warp(self, stream, False)
            setattr(_MINE, self.alias, stream)

    kind.stream, kind.set_stream = property(stream, set_stream), set_stream


class Turns:
    """A lock that the thread which holds it may take again.

    On a GPU, the stream waits for torch's current one when a turn begins, and torch's for it when
    it ends. Once several threads have had turns, one ends when its stream has finished, as what it
    drops may be taken by the next one.
    """

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.default_streams: dict[str, wp.Stream] = {}
        """Default streams of the devices that are watched, by alias."""
        self._depth = 0
        self._threads: set[int] = set()
        self._devices: list[wp.Device] = []
        self._of_torch: dict[tuple[str, int], wp.Stream] = {}

    def watch(self, device: wp.Device) -> None:
        """Give each thread a current stream of a device."""
        if device.is_cuda and device not in self._devices:
            self.default_streams[device.alias] = device.stream
            _give_threads_streams(type(device))
            self._devices.append(device)

    def __enter__(self) -> Turns:
        self.lock.acquire()
        self._depth += 1
        if self._depth == 1:
            self._threads.add(threading.get_ident())
            self._make_current()
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
            self.lock.release()

    def wait_for(self, device: wp.Device) -> None:
        """Wait until the current stream of ``device`` has finished; others have their turn."""
        if not device.is_cuda or len(self._threads) == 1:
            return
        depth, self._depth = self._depth, 0
        for _ in range(depth):
            self.lock.release()
        try:
            wp.synchronize_stream(device.stream)
        finally:
            for _ in range(depth):
                self.lock.acquire()
            self._depth = depth
            self._make_current()

    def _make_current(self) -> None:
        """Makes the thread's streams current below Warp's devices, too."""
        if len(self._threads) > 1:
            for device in self._devices:
                device.set_stream(device.stream, False)

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
        if key not in self._of_torch:
            self._of_torch[key] = wp.Stream(device, cuda_stream=handle)
        return self._of_torch[key]


TURNS = Turns()
"""Turns of this process."""


def in_turn(function: Callable[P, T]) -> Callable[P, T]:
    """The function, run when it is this thread's turn."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        with TURNS:
            return function(*args, **kwargs)

    return run
