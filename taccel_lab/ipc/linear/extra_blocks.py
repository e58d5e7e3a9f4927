# SPDX-License-Identifier: Apache-2.0
"""Blocks of the Newton matrix outside of its fixed pattern: contact between two free bodies."""

from __future__ import annotations

from typing import ClassVar

import warp as wp

from taccel_lab.ipc.capacity import MOST_ENTRIES, GrowingList


class ExtraBlocks(GrowingList):
    """A list of blocks (row > column) per environment; several entries of one place add up.

    A count beyond the room means that blocks were lost: solvers read no further than the list goes,
    and whoever assembled them has to notice.
    """

    columns: ClassVar = {"places": wp.vec2i, "values": wp.mat33d}
    # Solvers count the numbers of the blocks, and copies of them that are padded (``extra_rows``).
    most_entries: ClassVar = MOST_ENTRIES // 32
    places: wp.array
    """(row, column), shape [capacity]."""
    values: wp.array
    """Blocks [N/m], shape [capacity]."""

    def __init__(
        self, env_count: int, device: wp.Device, room: int = 1, limit: int = 1 << 24
    ) -> None:
        super().__init__(env_count, device, room, limit)

    def clear(self, active: wp.array | None = None) -> None:
        """Forget the blocks of active environments (int32, [env_count]); of all when None."""
        if active is None:
            self.counts.zero_()
        else:
            super().clear(active)
