# SPDX-License-Identifier: Apache-2.0
"""Only the newest wish is worked on to its end."""

from __future__ import annotations

import threading
from collections.abc import Callable

from taccel_lab.viewer.newest_first import NewestFirst


def test_wishes_between_are_left_out_and_the_work_at_hand_hears_of_it() -> None:
    began, go_on = threading.Event(), threading.Event()
    done: list[tuple[int, bool]] = []

    def work(wish: int, superseded: Callable[[], bool]) -> None:
        if wish == 0:
            began.set()
            assert go_on.wait(10)
        done.append((wish, superseded()))

    queue = NewestFirst(work)
    queue.ask(0)
    assert began.wait(10)
    assert not queue.wait(0.01)
    for wish in range(1, 50):
        queue.ask(wish)
    go_on.set()
    assert queue.wait(10)
    assert done == [(0, True), (49, False)]
    queue.close()


def test_closing_tells_the_work_at_hand_and_drops_what_waits() -> None:
    began, heard, wishes = threading.Event(), threading.Event(), []

    def work(wish: int, superseded: Callable[[], bool]) -> None:
        wishes.append(wish)
        began.set()
        while not superseded():
            pass
        heard.set()

    queue = NewestFirst(work)
    queue.ask(1)
    assert began.wait(10)
    queue.close()
    assert heard.is_set()
    queue.ask(2)
    assert wishes == [1]
