# SPDX-License-Identifier: Apache-2.0
"""A process beside this one for work that nobody waits for, such as figures."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any, Self

from taccel_lab.processes.child_process import ChildProcess
from taccel_lab.processes.process_pool import THREAD_LIMITS, usable_cores

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
            self._child = ChildProcess(_serve, environment=dict.fromkeys(THREAD_LIMITS, "1"))
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


def _serve(pipe: Connection) -> None:
    while True:
        function, arguments = pipe.recv()
        error: BaseException | None = None
        try:
            function(*arguments)
        except Exception as raised:
            error = raised
        pipe.send(error)
