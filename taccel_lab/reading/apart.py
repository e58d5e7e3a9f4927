# SPDX-License-Identifier: Apache-2.0
"""Foreign readers run in a process of their own, with limits on memory and time.

Libraries that decode CAD files, meshes, images and videos may crash on a damaged file, take all
memory or never return. What happens to that process becomes a sentence about the file; the next
file gets a fresh one.
"""

from __future__ import annotations

import atexit
import os
import threading
import traceback
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from taccel_lab.child_process import ChildProcess
from taccel_lab.errors import InputError
from taccel_lab.process_pool import THREAD_LIMITS

Result = TypeVar("Result")
MEMORY_BYTES = 2 << 30
"""That a reader may take."""
LIMIT_S = 120.0
"""Seconds that a reader may stay silent."""


def read_apart(
    what: str, read: Callable[..., Result], *arguments: Any, limit_s: float = LIMIT_S
) -> Result:
    """``read(*arguments)``, run in the readers' process.

    Args:
        what: The file, to begin a sentence with.
        read: A function of a module; its InputErrors are raised here.
        arguments: And its result: anything that pickles.
        limit_s: Seconds that it may take.

    Raises InputError when the process crashes, runs out of memory or takes too long.
    """
    with _readers.use() as reader:
        return reader.ask(what, read, arguments, False, limit_s)


def stream_apart(
    what: str, read: Callable[..., Iterator[Result]], *arguments: Any, limit_s: float = LIMIT_S
) -> Generator[Result, None, None]:
    """Items of the iterator ``read(*arguments)`` as they are read; limits are those of an item."""
    with _readers.use() as reader:
        item, more = reader.ask(what, read, arguments, True, limit_s)
        while more:
            yield item
            item, more = reader.next_item(what, limit_s)


class _Reader:
    """One readers' process."""

    def __init__(self) -> None:
        # Of 64 cores the stacks of the threads of two libraries take half of the memory.
        threads: dict[str, str] = dict.fromkeys(THREAD_LIMITS, "1")
        self.child = ChildProcess(
            _serve, memory_bytes=MEMORY_BYTES, environment=threads, quiet=True
        )
        self.owner = os.getpid()
        self.idle = True
        """Whether it waits for a file; one that was left amid a file is of no more use."""

    def ask(
        self,
        what: str,
        read: Callable[..., Any],
        arguments: tuple[Any, ...],
        stream: bool,
        limit_s: float,
    ) -> Any:
        self.idle = False
        try:
            self.child.pipe.send((read, arguments, stream))
        except (BrokenPipeError, ConnectionResetError):
            pass  # The answer says so.
        return self.next_item(what, limit_s) if stream else self._answer(what, limit_s)

    def next_item(self, what: str, limit_s: float) -> tuple[Any, bool]:
        """The next item of a stream and whether there was one."""
        kind, content = self._receive(what, limit_s)
        self.idle = kind == "end"
        return content, kind == "item"

    def _answer(self, what: str, limit_s: float) -> Any:
        _, content = self._receive(what, limit_s)
        self.idle = True
        return content

    def _receive(self, what: str, limit_s: float) -> tuple[str, Any]:
        try:
            if not self.child.pipe.poll(limit_s):
                raise InputError(
                    f"{what}: the reader did not finish within {limit_s:g} s; the file is damaged "
                    "or far too large"
                )
            kind, content = self.child.pipe.recv()
        except (EOFError, ConnectionResetError):
            raise InputError(
                f"{what}: the file is damaged: its reader crashed on it (the process "
                f"{self.child.cause_of_death()})"
            ) from None
        if kind == "memory":
            raise InputError(
                f"{what} needs more than {MEMORY_BYTES / 2**30:g} GiB of memory to be read; the "
                "file is damaged or far too large"
            )
        if kind == "error":
            self.idle = True
            raise content
        return kind, content


class _Readers:
    """The readers of this process that wait for a file."""

    def __init__(self) -> None:
        self._idle: list[_Reader] = []
        self._lock = threading.Lock()

    @contextmanager
    def use(self) -> Iterator[_Reader]:
        """A reader for one file."""
        reader = self._take()
        try:
            yield reader
        finally:
            with self._lock:
                if reader.idle:
                    self._idle.append(reader)
            if not reader.idle:
                reader.child.end()

    def _take(self) -> _Reader:
        with self._lock:
            # A process that was forked off has its parent's list, but not its children.
            self._idle = [reader for reader in self._idle if reader.owner == os.getpid()]
            if self._idle:
                return self._idle.pop()
        return _Reader()

    def end(self) -> None:
        """End those that wait."""
        with self._lock:
            for reader in self._idle:
                if reader.owner == os.getpid():
                    reader.child.end()
            self._idle = []


_readers = _Readers()
atexit.register(_readers.end)


def _serve(pipe: Connection) -> None:
    """Answer requests for as long as there are any."""
    while True:
        read, arguments, stream = pipe.recv()
        try:
            if stream:
                for item in read(*arguments):
                    pipe.send(("item", item))
                pipe.send(("end", None))
            else:
                pipe.send(("result", read(*arguments)))
        except MemoryError:
            pipe.send(("memory", None))
            return
        except Exception as error:  # Raised again where the file was asked for.
            if not isinstance(error, InputError):
                error.add_note(traceback.format_exc())
            pipe.send(("error", error))
