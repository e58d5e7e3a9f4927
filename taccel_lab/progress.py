# SPDX-License-Identifier: Apache-2.0
"""Who is told how far long work is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with the name of the task, how much of it is done, and how much there is in all."""


def silent(task: str, done: int, total: int) -> None:
    """Tells nobody."""
