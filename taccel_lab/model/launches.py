# SPDX-License-Identifier: Apache-2.0
"""Devices by name, and how work is launched on them: side by side, captured as a graph, in shared
memory.

Work that may run side by side: parallel branches of a captured graph.

A small scene keeps a few multiprocessors of a GPU busy, and its time is the sum of the latencies of
its kernels; those that do not wait for each other's results need not wait at all.

Memory that several parts use in turn.

The blocks of the elements are among the largest that an environment needs, and they are idle once
they are gathered: the linear solver keeps in the same place what it needs during a solve alone.
"""

from __future__ import annotations

import ctypes
import math
import signal
import sys
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.model.env_lists import Envs, ListedMask, place_count
from taccel_lab.processes.start_warp import start_warp


def require_device(name: str | wp.Device | None) -> wp.Device:
    """A device by its name, such as "cpu" or "cuda:0"; Warp's default for None.

    Raises:
        InputError: This machine does not have it, or there is nowhere to keep its kernels.
    """
    start_warp()
    try:
        return wp.get_device(name)
    except (ValueError, RuntimeError):  # RuntimeError: "cuda" without a driver.
        known = ", ".join(device.alias for device in wp.get_devices())
        raise InputError(f"device {name!r} is not there; this machine has: {known}") from None


WARP_THREADS = 32
"""Threads of a block where there are few, with much to do each, such as one an affine body: blocks
of a warp spread over the multiprocessors of a GPU, of which 256 bodies in one block keep one busy.
"""


def launch(
    kernel: wp.Kernel,
    dim: int | Sequence[int],
    *arguments: Any,
    device: wp.Device | None = None,
) -> None:
    """Launch a kernel where its arrays are, or on a ``device`` where it has only structs of them.

    A kernel that takes ``Envs`` may be given a mask, or a ``ListedMask``, which then says how many
    places its first dimension has; one that takes a mask gets that of either.

    Blocks have the size that the module states (option ``block_dim``), which is what it is compiled
    for; ``wp.launch`` alone takes 256 threads and compiles the module anew for them.
    """
    block_dim = kernel.module.options["block_dim"]
    device = device or _device_of(arguments)
    dim, given = _with_envs(kernel, dim, arguments)
    wp.launch(kernel, dim, given, device=device, block_dim=block_dim)


def launch_blocks(
    kernel: wp.Kernel, dim: int | Sequence[int], *arguments: Any, block_dim: int | None = None
) -> None:
    """Launch a kernel likewise, with a block for each index: of the size that the module states
    unless ``block_dim`` does."""
    block_dim = block_dim or kernel.module.options["block_dim"]
    device = _device_of(arguments)
    dim, given = _with_envs(kernel, dim, arguments)
    wp.launch_tiled(kernel, dim=dim, inputs=given, device=device, block_dim=block_dim)


def _device_of(arguments: Sequence[Any]) -> wp.Device:
    return next(value.device for value in arguments if isinstance(value, wp.array | ListedMask))


def _with_envs(
    kernel: wp.Kernel, dim: int | Sequence[int], arguments: Sequence[Any]
) -> tuple[int | Sequence[int], Sequence[Any]]:
    """Dimensions and arguments as the kernel takes them, see ``launch``."""
    given = list(arguments)
    for i, (value, declared) in enumerate(zip(arguments, kernel.adj.args, strict=True)):
        if declared.type is Envs:
            given[i] = (value if isinstance(value, ListedMask) else ListedMask(value)).envs
            if isinstance(value, ListedMask) and value.places is not None:
                places = place_count(value)
                dim = places if isinstance(dim, int) else (places, *dim[1:])
        elif isinstance(value, ListedMask):
            given[i] = value.mask
    return dim, given


_MOST = 6
"""Branches beside the first."""
_NON_BLOCKING = 1
"""CU_STREAM_NON_BLOCKING of the driver."""


def _stream_apart(device: wp.Device) -> wp.Stream:
    """A stream that the legacy stream and it do not wait for, which lasts as long as the process.

    Warp's own wait for each other with the legacy stream, which is torch's usual one: what another
    thread does there breaks a capture on one of Warp's, and fails itself.
    """
    driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    handle, popped = ctypes.c_void_p(), ctypes.c_void_p()
    errors = [driver.cuCtxPushCurrent_v2(ctypes.c_void_p(device.context))]
    errors.append(driver.cuStreamCreate(ctypes.byref(handle), ctypes.c_uint(_NON_BLOCKING)))
    errors.append(driver.cuCtxPopCurrent_v2(ctypes.byref(popped)))
    if any(errors):
        raise RuntimeError(f"{device} makes no stream: errors {errors} of the CUDA driver")
    return wp.Stream(device, cuda_stream=handle.value)


class Branches:
    """Streams of a device; on the CPU the parts run one after the other."""

    def __init__(self, device: wp.Device) -> None:
        self._device = device
        self.main: wp.Stream | None = None
        """Stream of a capture, which the others are beside."""
        self._streams: list[wp.Stream] = []
        self._done: list[wp.Event] = []
        if device.is_cuda:
            self.main = _stream_apart(device)
            self._streams = [_stream_apart(device) for _ in range(_MOST)]
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


def _branches(device: wp.Device) -> Branches:
    if device.alias not in _OF_DEVICE:
        _OF_DEVICE[device.alias] = Branches(device)
    return _OF_DEVICE[device.alias]


def side_by_side(device: wp.Device, parts: Sequence[Callable[[], None]]) -> None:
    """``Branches.run`` with the streams of a device."""
    _branches(device).run(parts)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Ctrl-C and SIGTERM wait until this is over. A capture takes milliseconds, and one that an
    exception leaves by half keeps the streams of the device busy for good."""
    held: list[tuple[Any, ...]] = []
    handlers: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            # Of no handler of Python's nothing is known; it does not raise either.
            if callable(signal.getsignal(number)):
                handlers[number] = signal.signal(number, lambda *caught: held.append(caught))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for number, frame in held:
        handlers[number](number, frame)


class CapturedWork:
    """Launches that are captured as a graph, and launched as a whole after that; with new arrays
    once as they come, unless their kernels are known to be loaded."""

    def __init__(self, device: wp.Device, wanted: bool = True) -> None:
        """``wanted``: False launches always as they come."""
        self._device, self._wanted = device, wanted
        self._graph: wp.Graph | None = None
        self._arrays: Hashable = None
        """What the graph was captured with, or is to be."""
        self._kernels: Hashable = None
        """Which kernels are loaded."""
        self.launches = 0
        """Graphs launched so far."""

    def clear(self) -> None:
        """Forget the graph: arrays that it uses have moved."""
        self._graph, self._arrays = None, None

    def launch(self, arrays: Hashable, work: Callable[[], None], kernels: Hashable = None) -> None:
        """Launch ``work``, the same at every call that gives the same ``arrays``: addresses, or
        what else tells those that it uses. It allocates nothing that lasts.

        ``kernels``: what tells the kernels that it launches, where arrays change seldom; as a
        capture takes as long as hundreds of launches."""
        if not self._wanted:
            work()
            return
        if arrays != self._arrays:
            self.clear()
            if kernels is None or kernels != self._kernels:
                work()
                self._arrays, self._kernels = arrays, kernels
                return
            self._arrays = arrays
        if self._graph is None:
            with _undisturbed():
                self._graph = self._capture(work)
        wp.capture_launch(self._graph)
        self.launches += 1

    def _capture(self, work: Callable[[], None]) -> wp.Graph:
        """The graph of all that ``work`` launches, whatever other threads do meanwhile."""
        device, stream = self._device, _branches(self._device).main
        with wp.ScopedStream(stream, sync_enter=False), wp.ScopedCapture(device) as captured:
            work()
        return captured.graph


def part_of(memory: wp.array, first: int, dtype: type, shape: tuple[int, ...]) -> wp.array:
    """Array on part of another one's memory, from byte ``first`` on, which it keeps alive."""
    part = wp.array(ptr=memory.ptr + first, dtype=dtype, shape=shape, device=memory.device)
    part._ref = memory
    return part


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
        first = self._used
        self._used += -(-size // _ALIGNMENT) * _ALIGNMENT
        return part_of(self._owner, first, dtype, shape)
