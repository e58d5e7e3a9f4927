# SPDX-License-Identifier: Apache-2.0
"""Readers that misbehave, for ``test_apart.py``: a process of its own finds them here."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from taccel_lab.errors import InputError


def double(value: np.ndarray) -> np.ndarray:
    return 2 * value


def process_number() -> int:
    return os.getpid()


def crash() -> None:
    os.abort()


def leave() -> None:
    os._exit(7)


def refuse() -> None:
    raise InputError("a.ply has no faces")


def mistake() -> None:
    raise KeyError("vertex")


def sleep() -> None:
    time.sleep(60)


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


def take_memory() -> int:
    return len(bytearray(8 << 30))


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


def harmed_stream(how: str) -> Iterator[int]:
    yield harm(how)


def harmed_late(how: str) -> Iterator[int]:
    """Items that come whole, until one is harmed."""
    yield 1
    yield 2
    harm(how)
    yield 3


def count(n: int) -> Iterator[int]:
    yield from range(n)


def count_and_crash(n: int) -> Iterator[int]:
    yield from range(n)
    os.abort()


def count_and_refuse(n: int) -> Iterator[int]:
    yield from range(n)
    raise InputError("v.avi is cut short")


def same(value: Any) -> Any:
    return value


def times(n: int) -> Iterator[float]:
    for _ in range(n):
        yield time.monotonic()


class _OwnError(Exception):
    def __init__(self, a: int, b: int) -> None:
        super().__init__(f"{a} and {b}")


def own_error() -> None:
    raise _OwnError(3, 4)
