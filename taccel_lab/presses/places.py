# SPDX-License-Identifier: Apache-2.0
"""Ends of the steps of a press, from which another press of the same gel searches that leads there,
too: the same way in fewer steps ends near by."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp


class Places:
    """Ends of steps, by how these led there."""

    def __init__(self) -> None:
        self.kept = False
        """Whether ends of steps are kept."""
        self._ends: dict[bytes, tuple[wp.array, np.ndarray]] = {}
        self._at = np.zeros(1)
        """Last end, as a row of all numbers."""
        self.known: dict[bytes, tuple[wp.array, np.ndarray]] = {}
        """Positions and ``setback_m`` at the ends of the way before."""

    def _way(self, *end: np.ndarray | float) -> tuple[bytes, np.ndarray]:
        """Name of a step that ends there, which tells down from up and out from back; and the end
        as a row."""
        row = np.concatenate([np.ravel(part) for part in end])
        return np.concatenate([row, np.sign(row - self._at)]).tobytes(), row

    def keep(self, positions: wp.array, setback_m: np.ndarray, *end: np.ndarray | float) -> None:
        """Keep where a step has ended: depths, shears and turns, in any one order."""
        if self.kept:
            way, self._at = self._way(*end)
            self._ends[way] = wp.clone(positions), setback_m.copy()

    def begin_again(self) -> None:
        """Say that the way begins anew."""
        self.known, self._ends, self._at = self._ends, {}, np.zeros(1)

    def start(
        self, *end: np.ndarray | float
    ) -> tuple[Callable[[wp.array], None], np.ndarray] | None:
        """Return what writes the positions that a step of the way before has led to, and its
        ``setback_m``; None where none has led to this end from there."""
        found = self.known.get(self._way(*end)[0]) if self.known else None
        return None if found is None else (partial(wp.copy, src=found[0]), found[1])
