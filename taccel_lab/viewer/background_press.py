# SPDX-License-Identifier: Apache-2.0
"""Work beside a page of which only the newest wish counts: in a thread, and the default press of a
design page in its own process.

That takes as long as all other pieces of an answer together. A thread would gain nothing: both
would wait for the interpreter's lock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Generic, TypeVar

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.processes.child_process import ChildProcess
from taccel_lab.processes.process_pool import THREAD_LIMITS
from taccel_lab.viewer.ball_press import BallPress, PressAnswer, SupersededError

if TYPE_CHECKING:
    from taccel_lab.sensors.base import FamilyParameters


class BackgroundPress:
    """Presses by default; only the newest one that was asked for counts.

    The process starts at once, so that it loads the solver while the page is built, and waits,
    warm, for wishes. They come from one thread.
    """

    def __init__(self) -> None:
        self._child: ChildProcess | None = _start()
        self._number = 0
        self.steps = (0, 0)
        """Steps of the press that are done, and how many it has; none before the first."""

    def begin(self, parameters: FamilyParameters, press: BallPress) -> None:
        """Simulate a press; one that is under way ends between two steps."""
        self._number += 1
        self.steps = (0, 0)
        if self._child is None:
            self._child = _start()
        try:
            # Nobody else may read earlier answers, and a full pipe would hold both processes up.
            while self._child.pipe.poll():
                self._child.pipe.recv()
            self._child.pipe.send((self._number, parameters, press))
        except (EOFError, OSError):
            pass  # It died while it was idle: ``poll`` says so.

    def poll(self, wait_s: float = 0.0) -> PressAnswer | None:
        """The press that was begun last, if it is there or comes within a time; ``steps`` is kept
        up to date, and a step that is done ends the waiting.

        Raises:
            InputError: As of ``press_ball``.
            SimulationError: The same; or the process died, and the next wish starts another one.
        """
        if self._child is None:
            return None
        try:
            while self._child.pipe.poll(wait_s):
                number, news = self._child.pipe.recv()
                if number != self._number:
                    continue
                if isinstance(news, (InputError, SimulationError)):
                    raise news
                if isinstance(news, PressAnswer):
                    return news
                self.steps, wait_s = news, 0.0
        except (EOFError, ConnectionResetError):
            cause = self._child.cause_of_death()
            self.close()
            raise SimulationError(f"the process of the default press {cause}") from None
        return None

    def close(self) -> None:
        """End the process, whatever it is at."""
        if self._child is not None:
            self._child.end()
            self._child = None


def _start() -> ChildProcess:
    return ChildProcess(_serve, environment=dict.fromkeys(THREAD_LIMITS, "1"))


def _serve(pipe: Connection) -> None:
    """Presses, for as long as the page lives."""
    from taccel_lab.processes.start_warp import start_warp

    start_warp()
    from taccel_lab.viewer.design_press import press_ball

    while True:
        wish = pipe.recv()
        while pipe.poll():
            wish = pipe.recv()  # Of those that came during the last press, only the newest counts.
        number, parameters, press = wish

        def step(done: int, total: int, number: int = number) -> None:
            _tell(pipe, number, (done, total))

        try:
            news = press_ball(parameters, press, quick=False, superseded=pipe.poll, step=step)
        except SupersededError:
            continue
        except (InputError, SimulationError) as error:
            news = error
        _tell(pipe, number, news)


def _tell(pipe: Connection, number: int, news: object) -> None:
    try:
        pipe.send((number, news))
    except OSError:
        raise EOFError from None  # The page is gone, and this process ends with it.


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
