# SPDX-License-Identifier: Apache-2.0
"""Work on a GPU that is recorded once as a graph, and then replayed on other images of the same
size.

A reading is some hundreds of small kernels, which a host launches more slowly than a GPU runs them.
A replay is one launch, and the host waits for nothing but the result. Sizes that follow the images
are those of a ``Room``: where an image asks for more, the graph is recorded anew with twice that,
and the image read again.
"""

from __future__ import annotations

import gc
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from taccel_lab.reading.room import Room

MOST_KEPT = 6
"""Recordings that are kept, by what is read and how."""
STAGED_BYTES = 1 << 22
"""Inputs of the host that are larger are copied by several cores."""
STAGED_PARTS, STAGED_CORES = 8, 4
_lock = threading.RLock()
"""Recordings share their memory: one is replayed at a time."""

Inputs = Sequence[torch.Tensor | None]
Work = Callable[[Sequence[Any]], Any]
"""What it gives is of tensors, which ``Copied`` knows how to copy."""
Copied = Callable[[Any], Any]


def replayed(
    kept: OrderedDict[Hashable, Recording],
    key: Hashable,
    work: Work,
    inputs: Inputs,
    device: str,
    copied: Copied,
) -> Any:
    """What work gives for inputs, by a recording of it.

    Args:
        kept: Recordings by their keys; the oldest ones go.
        key: Of work that does the same on inputs of the same shapes.
        work: Must not look at values of tensors but in sizes of its ``room``.
        inputs: Of the host or the device.
        device: Of torch, such as cuda:0.
        copied: Gives copies of the tensors of a result.
    """
    shapes = tuple(None if each is None else (each.shape, each.dtype) for each in inputs)
    with _lock, torch.cuda.device(device), torch.no_grad():
        whole = key, shapes
        if whole not in kept:
            kept[whole] = Recording(work, inputs, device)
        kept.move_to_end(whole)
        while len(kept) > MOST_KEPT:
            kept.popitem(last=False)
        return kept[whole](inputs, copied)


class Recording:
    """Work as a graph, its inputs and its room."""

    def __init__(self, work: Work, inputs: Inputs, device: str) -> None:
        self._work, self.room = work, Room()
        self._inputs = [None if x is None else torch.empty_like(x, device=device) for x in inputs]
        self._graph: torch.cuda.CUDAGraph | None = None
        self._result: Any = None
        self._asked = torch.empty(0)
        self._constants: list[torch.Tensor] = []
        self._staged: dict[int, torch.Tensor] = {}

    def __call__(self, inputs: Inputs, copied: Copied) -> Any:
        """What work gives for other inputs of the same shapes."""
        for k, (own, given) in enumerate(zip(self._inputs, inputs, strict=True)):
            if own is not None and given is not None:
                if given.is_cuda or given.is_pinned() or given.nbytes < STAGED_BYTES:
                    own.copy_(given, non_blocking=True)
                else:
                    self._stage(k, own, given)
        while True:
            if self._graph is None:
                self._record()
            assert self._graph is not None
            self._graph.replay()
            found = copied(self._result)
            # The one time that the host waits.
            if self.room.enough(self._asked.tolist()):
                return found
            self._graph = None

    def _stage(self, k: int, own: torch.Tensor, given: torch.Tensor) -> None:
        """Copy a large input of the host part by part over memory that a GPU reads by itself, so
        that several cores copy at once, and the GPU meanwhile."""
        if k not in self._staged:
            self._staged[k] = torch.empty(given.shape, dtype=given.dtype, pin_memory=True)
        staged = self._staged[k]
        pairs = [x.flatten().tensor_split(STAGED_PARTS) for x in (staged, given)]
        copies = [_cores().submit(mid.copy_, part) for mid, part in zip(*pairs, strict=True)]
        for copy, part, mid in zip(
            copies, own.flatten().tensor_split(STAGED_PARTS), pairs[0], strict=True
        ):
            copy.result()
            part.copy_(mid, non_blocking=True)

    def unrecorded(self, inputs: Inputs) -> Any:
        """The same, launch by launch, in the same room."""
        with self.room.entered():
            return self._work([None if x is None else x.to(self._asked.device) for x in inputs])

    def _record(self) -> None:
        self._result, self._constants = None, []
        device, now = torch.cuda.current_device(), torch.cuda.current_stream()
        stream, pool = _stream(device), _pool(device)[0]
        stream.wait_stream(now)
        with torch.cuda.stream(stream):
            # Sizes, tables and libraries' own memory are there before the second time.
            for _ in range(2):
                with self.room.entered():
                    self._work(self._inputs)
        stream.synchronize()
        graph, constants = torch.cuda.CUDAGraph(), _Constants()
        # Graphs of readers that are gone must not be taken down while one is recorded.
        gc.collect()
        collects = gc.isenabled()
        gc.disable()
        try:
            with (
                torch.cuda.graph(graph, pool, stream, capture_error_mode="thread_local"),
                self.room.entered(),
                constants,
            ):
                self._result = self._work(self._inputs)
                self._asked = self.room.asked()
        finally:
            if collects:
                gc.enable()
        now.wait_stream(stream)
        self._graph, self._constants = graph, constants.found


class _Constants(TorchDispatchMode):
    """Keeps tensors that a recording reads, and did not make: caches of them may be emptied."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[torch.Tensor] = []
        self._known: set[int] = set()

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        for each in tree_leaves((args, kwargs)):
            if isinstance(each, torch.Tensor) and self._new(each):
                self.found.append(each)
        made = func(*args, **(kwargs or {}))
        for each in tree_leaves(made):
            if isinstance(each, torch.Tensor):
                self._new(each)
        return made

    def _new(self, tensor: torch.Tensor) -> bool:
        """Whether the memory of a tensor is met for the first time."""
        if tensor.device.type != "cuda":
            return False
        place = tensor.untyped_storage().data_ptr()
        new = place not in self._known
        self._known.add(place)
        return new


@cache
def _pool(device: int) -> Any:
    """Memory of all recordings on a device, and an empty one that keeps it when others go."""
    pool, keeper = torch.cuda.graph_pool_handle(), torch.cuda.CUDAGraph()
    with torch.cuda.graph(keeper, pool, _stream(device), capture_error_mode="thread_local"):
        kept = torch.zeros(1, device=f"cuda:{device}")
    return pool, keeper, kept


@cache
def _cores() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(STAGED_CORES, "images to a GPU")


@cache
def _stream(device: int) -> torch.cuda.Stream:
    return torch.cuda.Stream(device)
