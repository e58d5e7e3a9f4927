# SPDX-License-Identifier: Apache-2.0
"""Draws from a seed: the same on every machine and in every version of Python."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

Item = TypeVar("Item")


class Draw:
    """Only ``random()`` is used, whose numbers Python promises to keep for a seed."""

    def __init__(self, seed: str) -> None:
        self._random = random.Random(seed).random

    def below(self, count: int) -> int:
        """A whole number in [0, count)."""
        return int(self._random() * count)

    def pick(self, items: Sequence[Item]) -> Item:
        return items[self.below(len(items))]

    def chance(self, share: float) -> bool:
        return self._random() < share

    def some_bytes(self, count: int) -> bytes:
        return bytes(self.below(256) for _ in range(count))

    def span(self, length: int, most: int) -> tuple[int, int]:
        """Begin and end of a run of at most ``most``, at least one where there is room."""
        begin = self.below(max(length, 1))
        return begin, min(length, begin + 1 + self.below(most))


@dataclass(frozen=True)
class Surroundings:
    """What a mutation may use besides the file itself."""

    outside: Path
    """A file that no reader has any business with, by its absolute path."""
    others: tuple[bytes, ...] = field(default=())
    """Contents of the other files of the sample."""
