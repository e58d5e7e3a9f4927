# SPDX-License-Identifier: Apache-2.0
"""Foreign readers run in a separate process, with limits on memory and time.

Libraries that decode CAD files, meshes, images and videos may crash on a file, take all memory or
never return. What happens to that process becomes a sentence about the library, with its version:
it may crash on sound files too. The next file gets a fresh process; and a process that fails after
it has read other files may owe it to those, so that its file is read again in a fresh one.
"""

from __future__ import annotations

import atexit
import json
import os
import tempfile
import threading
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import packages_distributions, version
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any, TypeVar

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.plain_values import from_json, to_json
from taccel_lab.processes.child_process import ChildProcess, allow_cpu
from taccel_lab.processes.process_pool import THREAD_LIMITS

Result = TypeVar("Result")
Records = Callable[[], Iterable[type]]
"""Tells the classes that an answer may be made of; called when there is one."""
MEMORY_BYTES = 2 << 30
"""Most memory that a reader may take."""
LIMIT_S = 120.0
"""Seconds that a reader may stay silent."""
CPU_S, CPU_S_PER_MIB = 10.0, 2.0
"""Seconds of the processor that a reader may take for a file, and for each MiB of it. Libraries
that are misled by a small file may never end. To load one takes up to 3 s."""
KEPT_BYTES = 16 << 20
"""Largest place for arrays that is kept while a reader waits; larger ones are given back."""
MAX_IMAGE_PIXELS = 1 << 26
"""Most pixels of an image; cameras have up to 61 million."""
ENVIRONMENT = {
    # Of 64 cores the stacks of the threads of two libraries take half of the memory.
    **dict.fromkeys(THREAD_LIMITS, "1"),
    # OpenCV compares it with an image's header before it decodes.
    "OPENCV_IO_MAX_IMAGE_PIXELS": str(MAX_IMAGE_PIXELS),
    # A context on a GPU maps more than the memory that a reader may take.
    "CUDA_VISIBLE_DEVICES": "-1",
}
"""Variables that readers start with."""


def read_apart(
    what: str,
    read: Callable[..., Result],
    *arguments: Any,
    by: str,
    limit_s: float | None = None,
    pool: str = "",
    records: Records = tuple,
    size: int | None = None,
) -> Result:
    """``read(*arguments)``, run in the readers' process.

    Args:
        what: The file, to begin a sentence with.
        read: A function of a module; its InputErrors are raised here.
        arguments: Anything that pickles. Its result is numbers, texts, arrays, containers of such
            and ``records``: nothing that the process sends runs here.
        by: The foreign package that does it, by its import name; told where it crashes.
        limit_s: Seconds that it may take. When None, ``LIMIT_S``, and processor time by the size
            of the file ``what``.
        pool: Of the processes that may do it: a library that takes much of the memory itself, and
            keeps it, has its own, so that others can read on.
        records: Classes of dataclasses, named tuples, models or enumerations in the result.
        size: Bytes of all that is read, where the file ``what`` names others.

    Raises InputError when the process crashes, runs out of memory or takes too long.
    """
    asked = _Asked.of(what, by, limit_s, records, size)
    for fresh in (False, True):
        with _readers.use(fresh, pool) as reader:
            try:
                return reader.ask(asked, read, arguments, False)
            except _Failed:
                if not reader.has_read:
                    raise
    raise AssertionError("a fresh process has read nothing before")


def stream_apart(
    what: str,
    read: Callable[..., Iterator[Result]],
    *arguments: Any,
    by: str,
    limit_s: float | None = None,
    records: Records = tuple,
) -> Generator[Result, None, None]:
    """Items of the iterator ``read(*arguments)`` as they are read; limits are those of an item."""
    asked = _Asked.of(what, by, limit_s, records)
    given = 0
    for fresh in (False, True):
        with _readers.use(fresh) as reader:
            number = 0
            try:
                item, more = reader.ask(asked, read, arguments, True)
                while more:
                    number += 1
                    if number > given:  # The others were given before the first process failed.
                        given = number
                        yield item
                    item, more = reader.next_item(asked)
                return
            except _Failed:
                if not reader.has_read:
                    raise


@dataclass(frozen=True)
class _Asked:
    """What was asked of a reader; see ``read_apart``."""

    what: str
    by: str
    limit_s: float
    cpu_s: float | None
    """Seconds of the processor for an answer or an item; None: no limit."""
    records: Records

    @classmethod
    def of(
        cls, what: str, by: str, limit_s: float | None, records: Records, size: int | None = None
    ) -> _Asked:
        if limit_s is not None:
            return cls(what, by, limit_s, None, records)
        try:
            size = os.stat(what).st_size if size is None else size
        except (OSError, ValueError):
            size = 0
        return cls(what, by, LIMIT_S, cpu_s_of(size), records)


def cpu_s_of(size: int) -> float:
    """Seconds of the processor that files of so many bytes are worth."""
    return CPU_S + CPU_S_PER_MIB * size / 2**20


class _Failed(InputError):
    """The process crashed or ran out of memory, which need not be the file's fault."""


class _Reader:
    """One readers' process."""

    def __init__(self, pool: str) -> None:
        self.pool = pool
        self.child = ChildProcess(
            _serve, memory_bytes=MEMORY_BYTES, environment=ENVIRONMENT, quiet=True
        )
        self.arrays = _place_for_arrays()
        """Where it puts the contents of arrays: through the pipe they would take far longer."""
        send_handle(self.child.pipe, self.arrays, None)
        self.owner = os.getpid()
        self.idle = True
        """Whether it waits for a file; one that was left amid a file is of no more use."""
        self.has_read = False
        """Whether it has read a file: what that one left in the process may harm the next."""

    def ask(
        self,
        asked: _Asked,
        read: Callable[..., Any],
        arguments: tuple[Any, ...],
        stream: bool,
    ) -> Any:
        self.idle = False
        try:
            # Paths are relative to where this process is now.
            self.child.pipe.send((os.getcwd(), read, arguments, stream, asked.cpu_s))
        except (BrokenPipeError, ConnectionResetError):
            pass  # The answer says so.
        return self.next_item(asked) if stream else self._answer(asked)

    def next_item(self, asked: _Asked) -> tuple[Any, bool]:
        """The next item of a stream and whether there was one."""
        kind, content = self._receive(asked)
        self.idle = kind == "end"
        if kind == "item":
            try:
                self.child.pipe.send("read")
            except (BrokenPipeError, ConnectionResetError):
                pass  # It died of the next one: that one's turn says so.
        return content, kind == "item"

    def _answer(self, asked: _Asked) -> Any:
        _, content = self._receive(asked)
        self.idle = True
        return content

    def _receive(self, asked: _Asked) -> tuple[str, Any]:
        try:
            if not self.child.pipe.poll(asked.limit_s):
                raise InputError(
                    f"{asked.what}: the reader did not finish within {asked.limit_s:g} s; the file "
                    "may be far too large, or damaged"
                )
            answer = self.child.pipe.recv_bytes()
        except (EOFError, ConnectionResetError):
            if self.child.took_too_long():
                raise InputError(
                    f"{asked.what}: the reader did not finish within {asked.cpu_s:.0f} s of the "
                    "processor; the file is damaged, or far more complex than large"
                ) from None
            raise _Failed(
                f"{asked.what}: {_version(asked.by)} crashed on it (the process "
                f"{self.child.cause_of_death()}). The file may be sound. Save it again, from "
                "another program or with other settings, or try another version of that library; "
                "if that does not help, report the file"
            ) from None
        try:
            kind, text, sizes = json.loads(answer)
            records = () if kind == "error" else asked.records()
            content = from_json(text, self._buffers(sizes), records)
        except (ValueError, TypeError, LookupError):
            raise InputError(
                f"{asked.what}: {_version(asked.by)} gave what is no answer; the file may have "
                "misled it: do not open it elsewhere, and report it"
            ) from None
        if kind == "memory":
            raise _Failed(
                f"{asked.what} needs more than {MEMORY_BYTES / 2**30:g} GiB of memory to be read; "
                "the file may be far too large, or damaged"
            )
        if isinstance(content, Exception) and kind == "error":
            self.idle = True
            raise content
        return kind, content

    def _buffers(self, sizes: list[int]) -> Iterator[np.ndarray]:
        at = 0
        if sum(sizes) > os.fstat(self.arrays).st_size or min(sizes, default=0) < 0:
            raise ValueError("arrays are larger than their place")
        for size in sizes:
            buffer, done = np.empty(size, dtype=np.uint8), 0
            while done < size:
                done += os.preadv(self.arrays, [buffer[done:].data], at + done)
            at += size
            yield buffer

    def end(self) -> None:
        self.child.end()
        os.close(self.arrays)


def _version(package: str) -> str:
    """What was installed to give a package, and its version: "vtk 9.7.1"."""
    # An import name has as many sources as people made builds of it (OpenCV has four).
    sources = sorted(set(packages_distributions().get(package, ())))
    return " and ".join(f"{source} {version(source)}" for source in sources) or package


def _place_for_arrays() -> int:
    """Descriptor of a file without a name that both processes read and write."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("arrays")
    # Systems without files in memory (macOS): one on disk that is gone when it is closed.
    with tempfile.TemporaryFile(buffering=0) as file:
        return os.dup(file.fileno())


class _Readers:
    """The readers of this process that wait for a file."""

    def __init__(self) -> None:
        self._idle: list[_Reader] = []
        self._lock = threading.Lock()

    @contextmanager
    def use(self, fresh: bool = False, pool: str = "") -> Iterator[_Reader]:
        """A reader for one file; a ``fresh`` one has read none before."""
        reader = _Reader(pool) if fresh else self._take(pool)
        try:
            yield reader
        finally:
            with self._lock:
                if reader.idle:
                    reader.has_read = True
                    self._idle.append(reader)
            if not reader.idle:
                reader.end()

    def _take(self, pool: str) -> _Reader:
        with self._lock:
            # A process that was forked off has its parent's list, but not its children.
            self._idle = [reader for reader in self._idle if reader.owner == os.getpid()]
            for reader in reversed(self._idle):
                if reader.pool == pool:
                    self._idle.remove(reader)
                    return reader
        return _Reader(pool)

    def end(self) -> None:
        """End those that wait."""
        with self._lock:
            for reader in self._idle:
                if reader.owner == os.getpid():
                    reader.end()
            self._idle = []


_readers = _Readers()
atexit.register(_readers.end)


class _Answers:
    """What the readers' process sends back."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._arrays = recv_handle(pipe)
        self._unread = False
        self._filled = 0

    def send(self, kind: str, content: Any) -> None:
        if self._unread:  # The place of its arrays is not yet free.
            self._pipe.recv()
        text, arrays = to_json(content)
        views = [array.reshape(-1).view(np.uint8).data for array in arrays]
        sizes = [view.nbytes for view in views]
        if self._filled > KEPT_BYTES:
            os.ftruncate(self._arrays, 0)
        self._filled, at = sum(sizes), 0
        for view in views:
            while len(view):
                written = os.pwrite(self._arrays, view, at)
                view, at = view[written:], at + written
        self._pipe.send_bytes(json.dumps([kind, text, sizes]).encode())
        self._unread = kind == "item"


def _serve(pipe: Connection) -> None:
    """Answer requests for as long as there are any."""
    answers = _Answers(pipe)
    while True:
        folder, read, arguments, stream, cpu_s = pipe.recv()
        try:
            os.chdir(folder)
            allow_cpu(cpu_s)
            if stream:
                for item in read(*arguments):
                    answers.send("item", item)
                    allow_cpu(cpu_s)
                answers.send("end", None)
            else:
                answers.send("result", read(*arguments))
        except MemoryError:
            answers.send("memory", None)
            return
        except Exception as error:  # Raised again where the file was asked for.
            if not isinstance(error, InputError):
                error.add_note(traceback.format_exc())
            answers.send("error", error)
