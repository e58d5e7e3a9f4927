# SPDX-License-Identifier: Apache-2.0
"""Readers that misbehave, for ``test_apart.py``: a process of its own finds them here."""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from taccel_lab.errors import InputError
from tests.support.strangers import Payload


def refuse() -> None:
    raise InputError("a.ply has no faces")


def send_a_pickle(place: str) -> None:
    """Answer as a library might that a file has taken over."""
    frame = sys._getframe()
    while "answers" not in frame.f_locals:
        assert frame.f_back is not None
        frame = frame.f_back
    payload = Payload(Path(place))
    frame.f_locals["pipe"].send(("result", pickle.dumps(payload), []))
    frame.f_locals["pipe"].send(payload)


def unsendable() -> object:
    return open


def mistake() -> None:
    raise KeyError("vertex")


def reserve(count: int) -> int:
    """Ask for memory without filling it."""
    return len(bytearray(count))


def spin() -> None:
    while True:
        pass


def items_of_work(count: int) -> Iterator[int]:
    """Items that each take 0.6 s of the processor."""
    for number in range(count):
        end = time.process_time() + 0.6
        while time.process_time() < end:
            pass
        yield number


_read: list[int] = []
"""Grows with each file that this process reads by ``harm``."""


def harm(how: str) -> int:
    """Leave the process as a damaged file may: the next file is harmed by it."""
    _read.append(1)
    if len(_read) > 1:
        if how == "crash":
            os.abort()
        raise MemoryError
    return os.getpid()


def harmed(how: str, *before: int) -> Iterator[int]:
    """Items that come whole, until one is harmed."""
    yield from before
    yield harm(how)


def count_and(n: int, end: str) -> Iterator[int]:
    yield from range(n)
    if end == "crashed":
        os.abort()
    raise InputError("v.avi is cut short")


def times(n: int) -> Iterator[float]:
    for _ in range(n):
        yield time.monotonic()


class _OwnError(Exception):
    def __init__(self, a: int, b: int) -> None:
        super().__init__(f"{a} and {b}")


def own_error() -> None:
    raise _OwnError(3, 4)
