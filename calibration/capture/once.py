# SPDX-License-Identifier: Apache-2.0
"""Results that several steps of a command ask of the same captures, made once."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

Result = TypeVar("Result")


class Once:
    """What was made of the captures that hold this, and lives as long as they do.

    Captures that ``dataclasses.replace`` makes of others begin anew: what was made of the others
    need not be true of them.
    """

    def __init__(self) -> None:
        self._made: dict[Hashable, Any] = {}

    def of(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """The result under ``key``; ``make`` is called where there is none yet."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]
