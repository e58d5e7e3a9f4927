# SPDX-License-Identifier: Apache-2.0
"""Work beside a page: only the newest wish counts, the default press has its own process."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from taccel_lab.errors import SimulationError
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.viewer.design_press import BallPress, PressAnswer, press_ball
from taccel_lab.viewer.newest_first import NewestFirst
from taccel_lab.viewer.press_beside import PressBeside


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


FLAT = sensor_family("flat_pad").parameters()
SHORT = BallPress(3.0, 0.2)


def answer_of(beside: PressBeside, seconds: float = 120.0) -> PressAnswer:
    limit = time.monotonic() + seconds
    while time.monotonic() < limit:
        found = beside.poll(0.1)
        if found is not None:
            return found
    raise AssertionError(f"no answer within {seconds:g} s")


def process_of(beside: PressBeside) -> int:
    assert beside._child is not None
    return beside._child._process.pid


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_the_newest_press_is_the_one_of_this_process_to_the_bit_and_a_dead_process_is_told() -> (
    None
):
    beside = PressBeside()
    try:
        # Older wishes never come, also those whose press is under way.
        beside.begin(FLAT, BallPress(3.0, 0.6))
        while beside.steps == (0, 0):
            assert beside.poll(0.1) is None
        assert beside.steps == (0, 3)
        for depth in (0.3, 0.4, 0.5):
            beside.begin(FLAT, BallPress(3.0, depth))
        beside.begin(FLAT, SHORT)
        found = answer_of(beside)
        assert beside.steps == (0, 1)
        told: list[tuple[int, int]] = []
        here = press_ball(
            FLAT, SHORT, quick=False, superseded=lambda: False, step=lambda *at: told.append(at)
        )
        assert told == [(0, 1)]
        assert (found.force_n, found.error_n) == (here.force_n, here.error_n)
        np.testing.assert_array_equal(found.positions_m, here.positions_m)
        assert beside.poll() is None

        # What kills the process costs its press alone.
        beside.begin(FLAT, BallPress(3.0, 0.6))
        first = process_of(beside)
        os.kill(first, signal.SIGKILL)
        with pytest.raises(SimulationError, match="ended by signal 9"):
            answer_of(beside)
        beside.begin(FLAT, SHORT)
        assert answer_of(beside).force_n == here.force_n
        assert process_of(beside) != first
    finally:
        beside.close()


def test_closing_ends_a_press_under_way() -> None:
    beside = PressBeside()
    beside.begin(FLAT, BallPress(3.0, 0.6))
    process = process_of(beside)
    assert is_alive(process)
    beside.close()
    assert not is_alive(process)
    assert beside.poll() is None
    beside.close()
