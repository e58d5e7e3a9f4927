# SPDX-License-Identifier: Apache-2.0
"""Ragged lists: one array for all environments, with a capacity for each.

Kernels append with an atomic counter and drop what does not fit, but count it. The solver ends the
step of an environment whose list was too short (``overflows``), makes room when the attempt is
over, and takes the step again there: nothing is missing in what it reports, and no list has to be
looked at by the host in between.

The entries of an environment follow those of the one before it. An environment that needs more room
gets it alone: the memory of a list is the sum of what each environment has needed, not the largest
need times their number. The memory left on the device is queried first: where it does not
suffice, that environment is given up, and the others go on.

Of thousands of environments some one needs more room every few steps, and a graph that was captured
is worth nothing once its arrays have moved. So arrays grow beyond what is needed, and rooms within
them: entries then move, and the arrays stay.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar
from weakref import WeakMethod

import numpy as np
import warp as wp

from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})

_MEMINFO = Path("/proc/meminfo")


def free_memory(device: wp.Device) -> int | None:
    """Bytes that could still be allocated on a device; None where nobody says.

    Of a CPU what the system calls available, of a GPU what is free on it; what a pool keeps for
    later does not count.
    """
    if device.is_cuda:
        return int(device.free_memory)
    if not _MEMINFO.exists():
        return None
    for line in _MEMINFO.read_text().splitlines():
        name, _, amount = line.partition(":")
        if name == "MemAvailable":
            return 1024 * int(amount.split()[0])
    return None


MOST_ENTRIES = 2**31 - 1
"""Most entries of a list, all environments together: Warp counts places in an array by int32."""
_SHARE = 0.9
"""Part of the free memory that a list may grow into; others need some, too."""


def initial_capacity(env_count: int) -> int:
    """Entries of an environment that a list has room for at first: memory matters when there are
    many lists, and what more they need they get in their first steps."""
    return 4096 if env_count <= 16 else 128


@wp.struct
class ListRoom:
    """Where the entries of each environment are, in the arrays of a list.

    counts: entries; more than there is room for where the list was too short, [env_count].
    starts: place of the first entry, and the end of all room, [env_count + 1].
    peaks: most entries so far, those included that did not fit, [env_count].
    """

    counts: wp.array(dtype=wp.int32)
    starts: wp.array(dtype=wp.int32)
    peaks: wp.array(dtype=wp.int32)


def entry_types(lists: Any) -> dict[str, type]:
    """Types of the entries of a struct of lists, which has a ``room`` beside them, by name."""
    return {name: v.type.dtype for name, v in lists.vars.items() if name != "room"}


@wp.func
def room_for(env: int, room: ListRoom) -> int:
    """Entries that an environment has room for."""
    return room.starts[env + 1] - room.starts[env]


@wp.func
def list_end(env: int, room: ListRoom) -> int:
    """Place after the last entry of an environment; the first is at ``starts[env]``. A count beyond
    the room is that of a list which was too short."""
    return room.starts[env] + wp.min(room.counts[env], room_for(env, room))


@wp.func
def claim_place(env: int, room: ListRoom) -> int:
    """Place of one entry more, -1 without room for it; it counts all the same."""
    slot = wp.atomic_add(room.counts, env, 1)
    if slot < room_for(env, room):
        return room.starts[env] + slot
    return -1


@wp.func
def overflows(env: int, room: ListRoom) -> bool:
    """Whether a list was too short, which empties it; notes how long it should be."""
    count = room.counts[env]
    if count > room.peaks[env]:
        room.peaks[env] = count
    if count <= room_for(env, room):
        return False
    room.counts[env] = 0
    return True


@wp.kernel
def _clear_kernel(
    active: Envs,
    first: wp.array(dtype=wp.int32),
    second: wp.array(dtype=wp.int32),
):
    place = wp.tid()
    env = env_at(place, active)
    if env >= 0:
        first[env] = 0
        if second:
            second[env] = 0


@wp.kernel
def _move_entries_kernel(
    lanes: int,
    counts: wp.array(dtype=wp.int32),
    old_starts: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    entries: wp.array2d(dtype=wp.int32),
    moved: wp.array2d(dtype=wp.int32),
):
    """Copy entries, as a number of words each."""
    env, lane = wp.tid()
    first = old_starts[env]
    shift = starts[env] - first
    room = wp.min(old_starts[env + 1] - first, starts[env + 1] - starts[env])
    for at in range(first + lane, first + wp.min(counts[env], room), lanes):
        for word in range(entries.shape[1]):
            moved[at + shift, word] = entries[at, word]


def _words(array: wp.array) -> wp.array:
    """The same memory by entries, int32, [entry_count, word_count]."""
    words = wp.types.type_size_in_bytes(array.dtype) // 4
    return wp.array(ptr=array.ptr, shape=(len(array), words), dtype=wp.int32, device=array.device)


def plan_rooms(rooms: np.ndarray, peaks: np.ndarray, limit: int, most: int) -> np.ndarray:
    """Entries that each environment shall have room for, int64, [env_count], when some have less
    than their ``peaks``, the most that they ever listed.

    These get half as much again as their peak, but no more than ``limit``. What more than one
    environment, and more than one in sixteen, has needed is no burst, though: room for that goes to
    all, as moving the lists and taking a step again for each in turn would cost more.

    Environments that want more than the limit keep the ``rooms`` they have, and so do those that
    want most, one after the other, as long as all together would have room for more than ``most``.
    """
    rooms, peaks = rooms.astype(np.int64), peaks.astype(np.int64)
    if not (peaks > rooms).any():
        return rooms
    grows = (peaks > rooms) & (peaks <= limit)
    planned = np.where(grows, np.minimum(3 * peaks // 2, limit), rooms)
    rank = 2 + len(rooms) // 16
    if len(rooms) >= rank:
        usual = np.sort(np.where(peaks <= limit, peaks, 0))[-rank]
        for_all = np.maximum(planned, min(3 * usual // 2, limit))
        if for_all.sum() <= most:
            return for_all
    excess = planned.sum() - most
    for env in np.argsort(-peaks, kind="stable"):
        if excess <= 0:
            break
        excess -= planned[env] - rooms[env]
        planned[env] = rooms[env]
    return planned


class GrowingList:
    """A ragged list; subclasses say which arrays it has.

    Rooms never shrink: an environment that once had many contacts is likely to have them again, and
    what it takes is its own.
    """

    columns: ClassVar[dict[str, type]]
    """Arrays by name, with the type of an entry; all of shape [capacity]."""
    spare: ClassVar[float] = 0.125
    """Room to spare in arrays that grow, as a part of what is needed: rooms grow into it later."""
    most_entries: ClassVar[int] = MOST_ENTRIES
    """Most entries of all environments together."""

    def __init__(self, env_count: int, device: wp.Device, room: int, limit: int) -> None:
        """``room``: entries that there is room for at first, in each environment."""
        self.device = device
        self.limit = limit
        """Entries of an environment beyond which it is given up."""
        self.counts = wp.zeros(env_count, dtype=wp.int32, device=device)
        """Entries, int32, shape [env_count]; more than there is room for where that was short."""
        self.peaks = wp.zeros(env_count, dtype=wp.int32, device=device)
        """Most entries so far, where a step looked at them, int32, shape [env_count]."""
        self.entry_bytes = sum(map(wp.types.type_size_in_bytes, self.columns.values()))
        """Memory of an entry; who keeps arrays of the same length adds theirs."""
        self.starts = wp.zeros(env_count + 1, dtype=wp.int32, device=device)
        """Place of the first entry of each environment, and the end, int32, [env_count + 1]."""
        self.room = ListRoom()
        """Room of the list, for kernels."""
        self.room.counts, self.room.starts, self.room.peaks = self.counts, self.starts, self.peaks
        self.capacity = 0
        """Entries that the arrays hold: the room of all environments, and some to spare."""
        self.moves = 0
        """How often arrays, of the list or beside it, got other memory."""
        self._followers: list[WeakMethod[Callable[[wp.array], None]]] = []
        for name, dtype in self.columns.items():
            setattr(self, name, wp.zeros(0, dtype=dtype, device=device))
        self._allocate(min(room, limit))

    def _allocate(self, rooms: int | np.ndarray, most: int = 0) -> None:
        """Give each environment room for ``rooms`` entries; what is listed and still fits stays.

        Arrays that are too short get room to spare, as long as they do not exceed ``most``."""
        self.rooms = np.broadcast_to(np.asarray(rooms, dtype=np.int64), self.counts.shape).copy()
        """Entries there is room for, int64, shape [env_count]."""
        self.largest_room = int(self.rooms.max(initial=0))
        """Entries there is room for where there is most."""
        needed = int(self.rooms.sum())
        if needed > self.capacity:
            most = min(most, len(self.rooms) * self.limit)
            self.capacity = max(needed, min(needed + int(self.spare * needed), most))
            self.moves += 1
        before = wp.clone(self.starts)
        self.starts.assign(np.concatenate([[0], np.cumsum(self.rooms)]).astype(np.int32))
        for name in self.columns:
            setattr(self, name, self.moved(getattr(self, name), self.counts, before))
        for follower in self._followers:
            if fit := follower():
                fit(before)

    def follow(self, fit: Callable[[wp.array], None]) -> None:
        """Call a method, now and whenever entries move, with the ``starts`` as they were: it fits
        arrays beside the list to its ``capacity``. Nobody is kept alive for it."""
        fit(self.starts)
        self._followers.append(WeakMethod(fit))

    def moved(self, entries: wp.array, counts: wp.array, before: wp.array) -> wp.array:
        """Move ``entries`` from where the starts were ``before`` to where they are now, in the same
        memory if that holds ``capacity`` of them. ``counts``: entries of each environment,
        [env_count]."""
        moved = wp.zeros(self.capacity, dtype=entries.dtype, device=self.device)
        if len(entries):
            lanes = lane_count(self.device, len(counts), len(entries))
            inputs = [lanes, counts, before, self.starts, _words(entries), _words(moved)]
            launch(_move_entries_kernel, (len(counts), lanes), *inputs)
        if len(entries) != self.capacity:
            return moved
        wp.copy(entries, moved)
        return entries

    def renew(self) -> None:
        """Empty, with arrays made anew: whoever was moving entries was interrupted."""
        self.counts.zero_()
        self.starts.zero_()
        self.capacity = 0
        self._allocate(self.rooms)

    def clear(self, active: EnvMask) -> None:
        """Empty the lists of the active environments (int32, [env_count])."""
        clear_all(active, [self])

    def grow(self) -> np.ndarray:
        """Make room where entries did not fit; returns where there can be none, bool, [env_count].

        There can be none beyond ``limit``, and none beyond the free memory of the device: then the
        environment that wants most has to stand back.
        """
        return self._grow(self.peaks.numpy())

    def fit(self) -> bool:
        """Look at the counts and make room; whether entries are missing that now would fit.

        Environments for which there can be no room are emptied.
        """
        counts = self.counts.numpy()
        short = counts > self.rooms
        refused = self._grow(np.maximum(counts, self.peaks.numpy()))
        if refused.any():
            self.counts.assign(np.where(refused, 0, counts))
        return bool((short & ~refused).any())

    def _grow(self, peaks: np.ndarray) -> np.ndarray:
        if not (peaks > self.rooms).any():
            return np.zeros(len(peaks), dtype=bool)
        most = self._affordable()
        rooms = plan_rooms(self.rooms, peaks, self.limit, most)
        if (rooms > self.rooms).any():
            self._allocate(rooms, most)
        refused = peaks > rooms
        # Who was rejected has to ask again.
        self.peaks.assign(np.minimum(peaks, rooms).astype(np.int32))
        return refused

    def _affordable(self) -> int:
        """Entries that there could be room for, in all environments together."""
        free = free_memory(self.device)
        if free is None:
            return self.most_entries
        # Arrays move one after the other, in place, too: one is there beside its successor.
        widest = max(map(wp.types.type_size_in_bytes, self.columns.values()), default=0)
        left = int(_SHARE * free - self.capacity * widest)
        if left < 0:
            return int(self.rooms.sum())
        return min(self.capacity + left // self.entry_bytes, self.most_entries)

    def of(self, env: int, values: wp.array) -> np.ndarray:
        """What one of the arrays of this list holds for an environment, on the host."""
        first = int(self.starts.numpy()[env])
        count = min(int(self.counts.numpy()[env]), int(self.rooms[env]))
        return values[first : first + count].numpy() if count else values.numpy()[:0]


def clear_all(active: EnvMask, lists: Sequence[GrowingList]) -> None:
    """Empty one or two lists of the active environments (int32, [env_count]) in one launch."""
    first, second = lists[0], lists[1] if len(lists) > 1 else None
    launch(_clear_kernel, len(active), active, first.counts, second.counts if second else None)


def grow_all(lists: Sequence[GrowingList]) -> np.ndarray:
    """Make room in all lists that were too short; returns where there can be none in one of them,
    bool, [env_count]."""
    return np.any([part.grow() for part in lists], axis=0)
