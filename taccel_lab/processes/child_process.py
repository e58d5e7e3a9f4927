# SPDX-License-Identifier: Apache-2.0
"""Python processes of our own: a function of a module runs in each, with a pipe to this one.

Unlike the processes of ``multiprocessing`` they never run the caller's script again, so a script
needs no ``if __name__ == "__main__"``.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

_PARENTS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2)
"""Ctrl-C is the parent's, and so is what a batch system sends to all processes of a job: a child
that died of it would look as if its work had killed it."""

Serve = Callable[..., None]
"""What a child runs: a function of a module, called with the pipe and the given arguments."""


class ChildProcess:
    """A process that runs ``serve(pipe, *arguments)`` and ends with it, or with its parent.

    Args:
        serve: A function of a module.
        arguments: Handed on to it, pickled.
        memory_bytes: Memory of its own that it may take; more fails there. No limit when None, and
            on systems that keep none.
        environment: Variables that are set besides this process's.
        quiet: Whether what it prints is dropped, such as a library's own words before a crash.
    """

    def __init__(
        self,
        serve: Serve,
        *arguments: Any,
        memory_bytes: int | None = None,
        environment: dict[str, str] | None = None,
        quiet: bool = False,
    ) -> None:
        self.pipe, theirs = multiprocessing.Pipe()
        start = (
            f"import sys; sys.path[:] = {sys.path!r}; "
            f"from taccel_lab.processes.child_process import _main; "
            f"_main({theirs.fileno()}, {os.getpid()}, {memory_bytes!r})"
        )
        # Blocked from its first moment on: a child that is still loading would die of Ctrl-C.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _PARENTS)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", start],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL if quiet else None,
                stderr=subprocess.DEVNULL if quiet else None,
                pass_fds=[theirs.fileno()],
                env={**os.environ, **(environment or {})},
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        try:
            self.pipe.send((serve, arguments))
        except OSError:
            pass  # It died while it started: the pipe says so to whoever reads it.

    def end(self) -> None:
        """End it, whatever it is at."""
        self.pipe.close()
        self._process.kill()
        self._process.wait()

    def took_too_long(self) -> bool:
        """Whether a process whose pipe has closed was ended by ``allow_cpu``."""
        return self._process.wait() == -getattr(signal, "SIGXCPU", 0)

    def cause_of_death(self) -> str:
        """How a process whose pipe has closed came to its end, for "the process ..."."""
        code = self._process.wait()
        how = f"was ended by signal {-code}" if code < 0 else f"ended with code {code}"
        return how + ("; signal 9 often means that memory ran out" if code == -9 else "")


def _main(handle: int, parent: int, memory_bytes: int | None) -> None:
    for number in _PARENTS:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(parent,), daemon=True).start()
    if memory_bytes is not None:
        _limit_memory(memory_bytes)
    pipe = Connection(handle)
    try:
        serve, arguments = pipe.recv()
        serve(pipe, *arguments)
    except EOFError:
        pass  # The parent is done with this process.


def allow_cpu(seconds: float | None) -> None:
    """End this process once it has taken so much more processor time; never, when None."""
    import resource

    if not hasattr(signal, "SIGXCPU"):
        return
    taken = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    limit = resource.RLIM_INFINITY if seconds is None else math.ceil(taken + seconds)
    resource.setrlimit(resource.RLIMIT_CPU, (limit if hard == -1 else min(limit, hard), hard))


def _limit_memory(count: int) -> None:
    import resource

    # The data of a process: its heap and what it maps for itself, not the libraries it maps.
    limit = getattr(resource, "RLIMIT_DATA", resource.RLIMIT_AS)
    _, hard = resource.getrlimit(limit)
    allowed = count if hard == resource.RLIM_INFINITY else min(count, hard)
    resource.setrlimit(limit, (allowed, hard))
    # No image of its memory for each crash.
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


@contextmanager
def no_more_memory(count: int) -> Iterator[None]:
    """Let this process take ``count`` bytes besides what it has, no more; where Linux tells what
    it has."""
    try:
        with open("/proc/self/statm") as file:
            data = int(file.read().split()[5]) * os.sysconf("SC_PAGESIZE")
    except OSError:
        yield
        return
    import resource

    # The fifth number counts what the limit counts: heap, stacks and private maps.
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    lower = data + count if soft == resource.RLIM_INFINITY else min(soft, data + count)
    resource.setrlimit(resource.RLIMIT_DATA, (lower, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _end_with_parent(parent: int) -> None:
    """A parent that is killed cannot end its children, so they see to it themselves."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)
