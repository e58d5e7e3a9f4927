# SPDX-License-Identifier: Apache-2.0
"""Processes that work off items: one that dies or hangs takes only its own item along."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, Self, TypeVar

from taccel_lab.errors import is_of_a_file
from taccel_lab.processes.child_process import ChildProcess
from taccel_lab.processes.cores import bound_cores
from taccel_lab.progress import Progress, silent

Item = TypeVar("Item")
Result = TypeVar("Result")
Work = Callable[[Item, Progress], Result]
"""What is done with an item; a function of a module, or a ``partial`` of one, so that other
processes find it. It has the main thread of its process."""
THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def usable_cores() -> int:
    """Cores that this process may use: in a SLURM job at most those that it was given, since not
    every cluster binds its jobs to them."""
    cores = bound_cores()
    for name in ("SLURM_CPUS_PER_TASK", "SLURM_CPUS_ON_NODE"):
        given = os.environ.get(name, "")
        if given.isdecimal() and int(given) > 0:
            return min(cores, int(given))
    return cores


@dataclass(frozen=True)
class Finished(Generic[Item, Result]):
    """An item that was worked off."""

    item: Item
    result: Result


@dataclass(frozen=True)
class Died(Generic[Item]):
    """An item whose process ended, or was ended, before it was done."""

    item: Item
    cause: str


@dataclass(frozen=True)
class Underway:
    """What a process is doing."""

    worker: int
    what: str
    done: int
    total: int


class ProcessPool(Generic[Item, Result]):
    """Processes that work off items; they stay until the pool is closed.

    With ``processes`` = 0 this process does the work itself. A process that takes longer than
    ``limit_s`` over an item is ended.
    """

    def __init__(
        self, work: Work[Item, Result], processes: int, limit_s: float | None = None
    ) -> None:
        self._work, self._processes, self._limit_s = work, processes, limit_s
        self._idle: list[_Worker[Item, Result]] = []
        self._busy: list[_Worker[Item, Result]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in (*self._idle, *self._busy):
            worker.child.end()
        self._idle, self._busy = [], []

    def run(
        self, items: Iterable[Item]
    ) -> Generator[Finished[Item, Result] | Died[Item] | Underway, None, None]:
        """Work off items in order; yields what happens, as it happens.

        Raises:
            OSError: The work's own, in any process: a full disk ends no process, but all of it.
        """
        if not self._processes:
            for item in items:
                yield Finished(item, self._work(item, silent))
            return
        waiting = list(reversed(list(items)))
        while waiting or self._busy:
            while waiting and len(self._busy) < self._processes:
                self._start(waiting.pop())
            wait([worker.pipe for worker in self._busy], None if self._limit_s is None else 1.0)
            for worker in list(self._busy):
                event = worker.event(self._limit_s)
                if event is None:
                    continue
                if not isinstance(event, Underway):
                    self._busy.remove(worker)
                    if isinstance(event, Died):
                        worker.child.end()
                    else:
                        self._idle.append(worker)
                yield event

    def _start(self, item: Item) -> None:
        worker = self._idle.pop() if self._idle else self._new_worker(item)
        worker.item, worker.since = item, time.monotonic()
        self._busy.append(worker)
        try:
            worker.pipe.send(item)
        except (BrokenPipeError, ConnectionResetError):
            pass  # Died while it was idle or starting: its pipe says so at once.

    def _new_worker(self, item: Item) -> _Worker[Item, Result]:
        # One thread each, unless the user says else: the processes share the cores already.
        threads = {name: os.environ.get(name, "1") for name in THREAD_LIMITS}
        child = ChildProcess(_serve, pickle.dumps(self._work), environment=threads)
        taken = {worker.number for worker in self._busy}
        number = next(n for n in range(self._processes) if n not in taken)
        return _Worker(number, child, item, time.monotonic())


@dataclass
class _Worker(Generic[Item, Result]):
    number: int
    child: ChildProcess
    item: Item
    since: float

    @property
    def pipe(self) -> Connection:
        return self.child.pipe

    def event(self, limit_s: float | None) -> Finished[Item, Result] | Died[Item] | Underway | None:
        """News, if there are any."""
        try:
            if not self.pipe.poll():
                spent = time.monotonic() - self.since
                if limit_s is not None and spent > limit_s:
                    return Died(self.item, f"no answer after {spent:.0f} s")
                return None
            kind, content = self.pipe.recv()
        except (EOFError, ConnectionResetError):
            return Died(self.item, f"the process {self.child.cause_of_death()}")
        if kind == "error":
            raise content
        if kind == "result":
            return Finished(self.item, content)
        return Underway(self.number, *content)


def _serve(pipe: Connection, packed: bytes) -> None:
    """Work off the items that come, for as long as the parent lives.

    ``packed``: the work; what it imports may start Warp.
    """
    from taccel_lab.processes.start_warp import start_warp

    # Warnings about the device were the parent's already.
    start_warp()
    work: Work = pickle.loads(packed)

    def tell(what: str, done: int, total: int) -> None:
        try:
            pipe.send(("underway", (what, done, total)))
        except OSError:
            # The parent is gone: not a fault of the item, which stays undone.
            os._exit(1)

    while True:
        item = pipe.recv()
        try:
            answer = "result", work(item, tell)
        except OSError as error:
            if not is_of_a_file(error):
                raise
            answer = "error", error
        pipe.send(answer)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Have the BLAS of the libraries that are loaded run in one thread meanwhile.

    Threads that wait for each other take up to thirty times as long over a few hundred numbers, and
    add them up in another order: what is made of them would depend on the machine's cores.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


Call = Callable[..., None]
"""Calls a function of a module with arguments, now or later; what it returns is dropped."""


def at_once(function: Callable[..., Any], *arguments: Any) -> None:
    """Call it here and now."""
    function(*arguments)


class Beside:
    """Calls functions of modules in another process, one after the other, while this one goes on.

    On one core they are called here at once, and so are those whose process has died. Leaving the
    ``with`` ends it, whatever it is at; that may be done more than once.
    """

    def __init__(self) -> None:
        self._child: ChildProcess | None = None
        self._asked: list[Future[None]] = []
        self._ended = False
        if usable_cores() > 1:
            self._child = ChildProcess(_serve_calls, environment=dict.fromkeys(THREAD_LIMITS, "1"))
            # A pipe takes no more while the other end is busy, so that a thread waits for it.
            self._sender = ThreadPoolExecutor(1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._child is None or self._ended:
            return
        self._ended = True
        self._sender.shutdown(wait=False, cancel_futures=True)
        self._child.end()

    def call(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Have a function of a module called with arguments that can be pickled."""
        if self._child is None:
            function(*arguments)
        else:
            self._asked.append(self._sender.submit(self._ask, self._child, function, arguments))

    def finish(self) -> None:
        """Wait until everything has been called; raises the first error that there was."""
        asked, self._asked = self._asked, []
        for call in asked:
            call.result()

    def _ask(
        self, child: ChildProcess, function: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> None:
        try:
            child.pipe.send((function, arguments))
            error = child.pipe.recv()
        except (EOFError, OSError):
            if not self._ended:
                function(*arguments)
            return
        if error is not None:
            raise error


def _serve_calls(pipe: Connection) -> None:
    while True:
        function, arguments = pipe.recv()
        error: BaseException | None = None
        try:
            function(*arguments)
        except Exception as raised:
            error = raised
        pipe.send(error)
