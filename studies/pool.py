# SPDX-License-Identifier: Apache-2.0
"""Batches of designs in processes of their own: one that dies takes only its own batch along."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Self

from taccel_lab.studies.work import Batch, Job, work_off

THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""One thread each: the processes share the cores already."""


@dataclass(frozen=True)
class Finished:
    """A batch whose results stand in the study's folder."""

    batch: Batch


@dataclass(frozen=True)
class Died:
    """A batch whose process ended before its results stood there."""

    batch: Batch
    cause: str


@dataclass(frozen=True)
class Underway:
    """What a process is doing."""

    worker: int
    what: str
    done: int
    total: int


Event = Finished | Died | Underway


class Pool:
    """Processes that work off batches; they stay until the pool is closed.

    With ``processes`` = 0 this process does the work itself.
    """

    def __init__(self, job: Job, processes: int) -> None:
        self._job, self._processes = job, processes
        self._idle: list[_Worker] = []
        self._busy: list[_Worker] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in (*self._idle, *self._busy):
            worker.end()
        self._idle, self._busy = [], []

    def run(self, batches: Iterable[Batch]) -> Generator[Event, None, None]:
        """Work off batches in order; yields what happens. Results are in the study's folder."""
        if not self._processes:
            for batch in batches:
                work_off(self._job, batch)
                yield Finished(batch)
            return
        waiting = list(reversed(list(batches)))
        while waiting or self._busy:
            while waiting and len(self._busy) < self._processes:
                self._start(waiting.pop())
            wait([worker.pipe for worker in self._busy])
            for worker in list(self._busy):
                event = worker.event()
                if event is None:
                    continue
                if not isinstance(event, Underway):
                    self._busy.remove(worker)
                    if isinstance(event, Died):
                        worker.end()
                    else:
                        self._idle.append(worker)
                yield event

    def _start(self, batch: Batch) -> None:
        worker = self._idle.pop() if self._idle else self._new_worker(batch)
        worker.batch = batch
        self._busy.append(worker)
        try:
            worker.pipe.send(batch)
        except (BrokenPipeError, ConnectionResetError):
            pass  # Died while it was idle or starting: its pipe says so at once.

    def _new_worker(self, batch: Batch) -> _Worker:
        context = multiprocessing.get_context("spawn")
        mine, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self._job), daemon=True)
        with _single_threaded():
            process.start()
        theirs.close()
        taken = {worker.number for worker in self._busy}
        number = next(n for n in range(self._processes) if n not in taken)
        return _Worker(number, process, mine, batch)


@dataclass
class _Worker:
    number: int
    process: BaseProcess
    pipe: Connection
    batch: Batch

    def end(self) -> None:
        self.pipe.close()
        self.process.kill()
        self.process.join()

    def event(self) -> Event | None:
        """News, if there are any."""
        try:
            if not self.pipe.poll():
                return None
            message = self.pipe.recv()
        except (EOFError, ConnectionResetError):
            self.process.join()
            code = self.process.exitcode or 0
            how = f"was ended by signal {-code}" if code < 0 else f"ended with code {code}"
            hint = "; signal 9 often means that memory ran out" if code == -9 else ""
            return Died(self.batch, f"the process {how}{hint}")
        if message is None:
            return Finished(self.batch)
        return Underway(self.number, *message)


def _serve(pipe: Connection, job: Job) -> None:
    """Work off the batches that come, for as long as the parent lives."""
    import signal

    import warp as wp

    # Ctrl-C is the parent's.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # Warnings about the device were the parent's already.
    wp.config.log_level = wp.LOG_ERROR

    def tell(what: str, done: int, total: int) -> None:
        try:
            pipe.send((what, done, total))
        except OSError:
            # The parent is gone: not a fault of the designs, which stay without a row.
            os._exit(1)

    while True:
        try:
            batch = pipe.recv()
        except EOFError:
            return
        work_off(job, batch, tell)
        pipe.send(None)


def _end_with_parent() -> None:
    """A parent that is killed cannot end its children, so they see to it themselves."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Processes started within have one thread each; what the user set counts."""
    added = [name for name in THREAD_LIMITS if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
