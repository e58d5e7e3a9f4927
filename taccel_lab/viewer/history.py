# SPDX-License-Identifier: Apache-2.0
"""Undo and redo."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

TOGETHER_S = 1.0
"""Changes of one control within this time of each other are one step: a slider that is dragged."""


class History(Generic[T]):
    """Values in the order in which they came, and which of them is current."""

    def __init__(self, first: T, clock: Callable[[], float] = time.monotonic) -> None:
        self._values, self._at = [first], 0
        self._clock, self._control, self._changed_s = clock, "", float("-inf")

    def add(self, value: T, control: str) -> None:
        """Append a value that a change of ``control`` led to; what was undone is dropped."""
        if value == self._values[self._at]:
            return
        now = self._clock()
        together = control == self._control and now - self._changed_s < TOGETHER_S
        del self._values[self._at + 1 :]
        if together and self._at:
            self._values[self._at] = value
        else:
            self._values.append(value)
            self._at += 1
        self._control, self._changed_s = control, now

    def step(self, by: int) -> T | None:
        """Go back (-1) or forth (1) and return that value; None at the end."""
        if not 0 <= self._at + by < len(self._values):
            return None
        self._at, self._control = self._at + by, ""
        return self._values[self._at]
