# SPDX-License-Identifier: Apache-2.0
"""Ends of the steps of a press, from which another press of the same gel searches that leads there,
too: the same way in fewer steps ends near by."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp


class Places:
    """Where steps have ended, by how they led there."""

    def __init__(self) -> None:
        self.kept = False
        """Whether ends of steps are kept."""
        self._ends: dict[bytes, tuple[wp.array, np.ndarray]] = {}
        self.known: dict[bytes, tuple[wp.array, np.ndarray]] = {}
        """Positions and ``setback_m`` at the ends of the way before."""

    def keep(self, way: bytes, positions: wp.array, setback_m: np.ndarray) -> None:
        """Keep the end of a step."""
        if self.kept:
            self._ends[way] = wp.clone(positions), setback_m.copy()

    def begin_again(self) -> None:
        """Say that the way begins anew."""
        self.known, self._ends = self._ends, {}

    def start(self, way: bytes) -> tuple[Callable[[wp.array], None], np.ndarray] | None:
        """Return what writes the positions that a step of the way before has led to, and its
        ``setback_m``; None where none has."""
        found = self.known.get(way)
        return None if found is None else (partial(wp.copy, src=found[0]), found[1])


def way_of(
    depth_m: np.ndarray, more_m: np.ndarray, shear_m: np.ndarray, aside_m: np.ndarray,
    twist_rad: np.ndarray | float,
) -> bytes:  # fmt: skip
    """Name the end of a step and whether it leads there down or up, out or back.

    Args:
        depth_m: End of the step [m], [env_count].
        more_m: How much deeper that is [m], [env_count].
        shear_m: Likewise, [env_count, 2].
        aside_m: How much farther aside that is [m], [env_count, 2].
        twist_rad: One angle, one an environment, or rotation vectors.
    """
    parts = depth_m, np.sign(more_m), shear_m, np.sign(aside_m), twist_rad
    return b"".join(np.asarray(part, dtype=np.float64).tobytes() for part in parts)
