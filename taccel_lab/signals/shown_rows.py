# SPDX-License-Identifier: Apache-2.0
"""Environments that signals have a row of, and reads of their images as graphs.

A GPU takes less time for some hundred images than the host does for the launches. A graph is one
for a number of rows: it is rounded up, and rows beyond those that are shown repeat the last one.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.model.env_rows import chosen_numbers
from taccel_lab.model.launches import CapturedWork

_SIZES = 8
"""Numbers of rows that there are graphs for."""


class ShownRows:
    """Environments that signals have a row of, in their order."""

    def __init__(self, env_count: int, device: wp.Device, chunk_envs: int) -> None:
        """``chunk_envs``: rows that are computed at a time."""
        self._env_count, self._chunk = env_count, chunk_envs
        self._every = wp.array(np.arange(env_count), dtype=wp.int32, device=device)
        self._chosen = wp.zeros(env_count, dtype=wp.int32, device=device)
        self.show(None)

    def show(self, who: np.ndarray | None) -> None:
        """Show the environments of ``who`` (bool, [env_count], of the host), all when None.

        Raises:
            InputError: Not such a mask.
        """
        numbers = None if who is None else chosen_numbers(who, self._env_count)
        self.count = self._env_count if numbers is None else len(numbers)
        """Environments that are shown."""
        self.numbers = self._every
        """Their numbers, and the last one again and again, int32, [env_count]."""
        if numbers is not None:
            self.numbers = self._chosen
            if self.count:
                self._chosen.assign(np.pad(numbers, (0, self._env_count - self.count), "edge"))

    @property
    def rounded(self) -> int:
        """Rows of a graph that shows them."""
        step = -(-self._env_count // _SIZES)
        return min(-(-self.count // step) * step, self._env_count)

    def chunks(self, rows: int) -> Iterator[slice]:
        """Parts of the first ``rows`` that are computed at a time."""
        for first in range(0, rows, self._chunk):
            yield slice(first, min(first + self._chunk, rows))


class CapturedReads:
    """Graphs of reads."""

    def __init__(self, device: wp.Device, wanted: bool) -> None:
        self._device, self._wanted = device, wanted
        self._graphs: dict[Hashable, CapturedWork] = {}

    @property
    def captures(self) -> bool:
        """Whether reads are captured: not while a graph of the user's is."""
        taken = self._device.is_cuda and self._device.stream.is_capturing
        return self._wanted and not taken

    def launch(self, what: Hashable, arrays: list[Any], work: Callable[[], None]) -> None:
        """Launch ``work`` as ``CapturedWork`` does: ``what`` tells the launches, ``arrays`` are
        those that it reads, wherever these are."""
        if what not in self._graphs:
            self._graphs[what] = CapturedWork(self._device)
        self._graphs[what].launch(tuple((array.ptr, array.strides) for array in arrays), work)
