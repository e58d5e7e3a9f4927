# SPDX-License-Identifier: Apache-2.0
"""Lists of contacts with room for so many entries, and what happens when that is too little.

Kernels append with an atomic counter and drop what does not fit, but count it. The solver ends the
step of an environment whose list was too short (``overflows``), makes room when the attempt is
over, and takes the step again there: nothing is missing in what it reports, and no list has to be
looked at by the host in between.
"""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

wp.set_module_options({"enable_backward": False})


def initial_capacity(env_count: int) -> int:
    """Entries that a list has room for at first: memory matters when there are many lists."""
    return 4096 if env_count <= 16 else 512


@wp.kernel
def _clear_kernel(
    active: wp.array(dtype=wp.int32),
    first: wp.array(dtype=wp.int32),
    second: wp.array(dtype=wp.int32),
):
    env = wp.tid()
    if active[env] != 0:
        first[env] = 0
        if second:
            second[env] = 0


@wp.struct
class ListRoom:
    """What tells whether a list was too short: its counts, [env_count], how many entries there is
    room for, and the largest count that did not fit, [1]."""

    counts: wp.array(dtype=wp.int32)
    most: wp.array(dtype=wp.int32)
    capacity: wp.int32


@wp.func
def overflows(env: int, room: ListRoom) -> bool:
    """Whether a list was too short; notes how long it should be, and empties it."""
    if room.counts[env] <= room.capacity:
        return False
    wp.atomic_max(room.most, 0, room.counts[env])
    room.counts[env] = 0
    return True


class GrowingList:
    """Counts of a list in each environment; subclasses own the entries."""

    def __init__(self, env_count: int, device: wp.Device, limit: int) -> None:
        self.device = device
        self.limit = limit
        """Entries beyond which an environment is given up."""
        self.counts = wp.zeros(env_count, dtype=wp.int32, device=device)
        """Entries, int32, shape [env_count]; more than ``capacity`` where there was no room."""
        self.most = wp.zeros(1, dtype=wp.int32, device=device)
        """Largest count that did not fit, int32, shape [1]."""

    @property
    def capacity(self) -> int:
        """Entries there is room for."""
        raise NotImplementedError

    def _allocate(self, capacity: int) -> None:
        raise NotImplementedError

    @property
    def room(self) -> ListRoom:
        """For kernels; of the list as it is now."""
        room = ListRoom()
        room.counts, room.most, room.capacity = self.counts, self.most, self.capacity
        return room

    def clear(self, active: wp.array) -> None:
        """Empty the lists of the active environments (int32, [env_count])."""
        clear_all(active, [self])

    def grow(self) -> bool:
        """Make room for the largest count that did not fit; whether there is more room now."""
        most = int(self.most.numpy()[0])
        self.most.zero_()
        if most <= self.capacity or self.capacity >= self.limit:
            return False
        self._allocate(min(3 * most // 2, self.limit))
        return True

    def fit(self) -> bool:
        """Look at the counts and make room; whether entries are missing that now would fit.

        Environments beyond the limit are emptied.
        """
        counts = self.counts.numpy()
        if (counts > self.limit).any():
            counts[counts > self.limit] = 0
            self.counts.assign(counts)
        most = int(counts.max(initial=0))
        if most <= self.capacity:
            return False
        self._allocate(min(3 * most // 2, self.limit))
        return True


def clear_all(active: wp.array, lists: Sequence[GrowingList]) -> None:
    """Empty one or two lists of the active environments (int32, [env_count]) in one launch."""
    first, second = lists[0], lists[1] if len(lists) > 1 else None
    wp.launch(
        _clear_kernel,
        dim=len(active),
        inputs=[active, first.counts, second.counts if second else None],
        device=first.device,
    )


def grow_all(lists: Sequence[GrowingList]) -> bool:
    """Make room in all lists that were too short; whether any has more now."""
    grown = [part.grow() for part in lists]
    return any(grown)
