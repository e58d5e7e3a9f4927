# SPDX-License-Identifier: Apache-2.0
"""Work in the background of which only the newest wish counts."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Wish = TypeVar("Wish")


class NewestFirst(Generic[Wish]):
    """Calls ``work(wish, superseded)`` in its own thread, one wish at a time.

    A wish that comes while another is worked on replaces those that wait, and ``superseded()`` says
    so to the work at hand, which should then return soon.
    """

    def __init__(self, work: Callable[[Wish, Callable[[], bool]], None]) -> None:
        self._work = work
        self._waiting: list[Wish] = []
        self._changed = threading.Condition()
        self._busy = self._closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self, wish: Wish) -> None:
        """Work on a wish as soon as may be, in place of all before it."""
        with self._changed:
            self._waiting = [wish]
            self._changed.notify_all()

    def wait(self, timeout_s: float) -> bool:
        """Wait until nothing is left to do; whether that was so in time."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._busy or self._waiting), timeout_s)

    def close(self) -> None:
        """End after the work at hand, which learns that it is superseded."""
        with self._changed:
            self._closed = True
            self._waiting = []
            self._changed.notify_all()
        self._thread.join(timeout=30)

    def _superseded(self) -> bool:
        return bool(self._waiting) or self._closed

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._waiting) or self._closed)
                if self._closed:
                    return
                (wish,), self._waiting, self._busy = self._waiting, [], True
            try:
                self._work(wish, self._superseded)
            finally:
                with self._changed:
                    self._busy = False
                    self._changed.notify_all()
