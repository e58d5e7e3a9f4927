# SPDX-License-Identifier: Apache-2.0
"""Blocks of the Newton matrix outside of its fixed pattern: contact between two free bodies."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.capacity import GrowingList


class ExtraBlocks(GrowingList):
    """A list of blocks (row > column) per environment; several entries of one place add up.

    A count beyond the capacity means that blocks were lost: solvers read no further than the list
    goes, and whoever assembled them has to notice.
    """

    def __init__(
        self, env_count: int, device: wp.Device, capacity: int = 1, limit: int = 1 << 24
    ) -> None:
        super().__init__(env_count, device, limit)
        self._allocate(capacity)

    def _allocate(self, capacity: int) -> None:
        shape = (len(self.counts), capacity)
        self.places = wp.zeros(shape, dtype=wp.vec2i, device=self.device)
        """(row, column), shape [env_count, capacity]."""
        self.values = wp.zeros(shape, dtype=wp.mat33d, device=self.device)
        """Blocks [N/m], shape [env_count, capacity]."""

    @property
    def capacity(self) -> int:
        """Blocks that the list of one environment holds."""
        return self.places.shape[1]

    def clear(self, active: wp.array | None = None) -> None:
        """Forget the blocks of active environments (int32, [env_count]); of all when None."""
        if active is None:
            self.counts.zero_()
        else:
            super().clear(active)

    def overflowed(self) -> bool:
        """Read the counts back; when the list was too short make it long enough and say so."""
        return self.fit()
