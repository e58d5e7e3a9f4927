# SPDX-License-Identifier: Apache-2.0
"""Ragged lists: an environment that needs more room gets it alone, or is given up alone."""

from __future__ import annotations

import weakref

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.ipc.broad_phase.candidates import PairList
from taccel_lab.ipc.device import ragged_lists
from taccel_lab.ipc.device.ragged_lists import (
    ListRoom,
    claim_place,
    grow_all,
    overflows,
    plan_rooms,
)

CPU = wp.get_device("cpu")


@wp.kernel(enable_backward=False)
def _append_kernel(
    asked: wp.array(dtype=wp.int32), room: ListRoom, pairs: wp.array(dtype=wp.vec2i)
):
    env = wp.tid()
    for number in range(asked[env]):
        at = claim_place(env, room)
        if at >= 0:
            pairs[at] = wp.vec2i(env, number)


@wp.kernel(enable_backward=False)
def _look_kernel(room: ListRoom, missed: wp.array(dtype=wp.int32)):
    env = wp.tid()
    missed[env] = int(overflows(env, room))


def append(pairs: PairList, asked: np.ndarray) -> None:
    counts = wp.array(asked, dtype=wp.int32, device=CPU)
    wp.launch(_append_kernel, dim=len(asked), inputs=[counts, pairs.room, pairs.pairs], device=CPU)


SIZES = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 400)), min_size=1, max_size=12)


@given(sizes=SIZES, limit=st.integers(1, 300), spare=st.integers(0, 2000))
def test_planned_rooms(sizes: list[tuple[int, int]], limit: int, spare: int) -> None:
    """Rooms never shrink; who asks gets what is missing, or nothing, the most demanding first."""
    rooms, peaks = np.array(sizes).T
    rooms = np.minimum(rooms, limit)
    most = int(rooms.sum()) + spare
    planned = plan_rooms(rooms, peaks, limit, most)
    assert planned.sum() <= most and (planned >= rooms).all() and (planned <= limit).all()
    asks, refused = peaks > rooms, peaks > planned
    enough = np.minimum(3 * peaks // 2, limit)
    assert (planned[asks & ~refused] >= enough[asks & ~refused]).all()
    # Nobody gets more than all others would but for a burst of its own.
    if len(peaks) > 1:
        second = np.sort(np.where(peaks <= limit, peaks, 0))[-2]
        usual = min(3 * second // 2, limit) if asks.any() else 0
        assert (planned <= np.maximum(np.maximum(rooms, usual), np.where(asks, enough, 0))).all()
    # Whoever was refused without reaching the limit wanted at least as much as who was served.
    short_of_memory = refused & (peaks <= limit)
    if short_of_memory.any() and (asks & ~refused).any():
        assert peaks[short_of_memory].min() >= peaks[asks & ~refused].max()
    if not short_of_memory.any():
        np.testing.assert_array_equal(refused, peaks > np.maximum(rooms, limit))


def test_what_many_need_goes_to_all() -> None:
    """Lest the lists move, and a step is taken again, for each of them in turn."""
    rooms, peaks = np.full(64, 500), np.full(64, 300)
    peaks[:3] = 510
    np.testing.assert_array_equal(plan_rooms(rooms, peaks, 10_000, 10**9)[:3], 765)
    assert plan_rooms(rooms, peaks, 10_000, 10**9).sum() == 3 * 765 + 61 * 500
    peaks[:6] = 510
    assert (plan_rooms(rooms, peaks, 10_000, 10**9) == 765).all()
    # Not where memory is short.
    assert plan_rooms(rooms, peaks, 10_000, 40_000).sum() == 6 * 765 + 58 * 500


@pytest.mark.thorough
@given(bursts=st.lists(st.lists(st.integers(0, 30), min_size=4, max_size=4), max_size=6))
def test_lists_hold_what_was_appended(bursts: list[list[int]]) -> None:
    pairs = PairList(4, CPU, 3, 1000)
    everyone = wp.full(4, 1, dtype=wp.int32, device=CPU)
    for burst in map(np.array, bursts):
        before = pairs.rooms
        pairs.clear(everyone)
        append(pairs, burst)
        if pairs.fit():
            pairs.clear(everyone)
            append(pairs, burst)
            assert not pairs.fit()
        assert (pairs.rooms >= np.maximum(burst, before)).all()
        starts = pairs.starts.numpy()
        assert starts[0] == 0 and starts[-1] <= pairs.capacity == len(pairs.pairs)
        np.testing.assert_array_equal(np.diff(starts), pairs.rooms)
        # Each environment has its own pairs, in the order in which they came.
        for env, count in enumerate(burst):
            expected = np.column_stack([np.full(count, env), np.arange(count)])
            np.testing.assert_array_equal(pairs.of(env, pairs.pairs), expected)


class Beside:
    """An array beside a list, of entries of its own number."""

    def __init__(self, pairs: PairList, counts: np.ndarray) -> None:
        self.pairs = pairs
        self.counts = wp.array(counts, dtype=wp.int32, device=CPU)
        self.owners = wp.zeros(0, dtype=wp.int32, device=CPU)
        pairs.follow(self.fit)

    def fit(self, before: wp.array) -> None:
        self.owners = self.pairs.moved(self.owners, self.counts, before)

    def write(self) -> None:
        rooms = self.pairs.rooms
        owners = np.full(self.pairs.capacity, -1)
        owners[: rooms.sum()] = np.repeat(np.arange(len(rooms)), rooms)
        self.owners.assign(owners)

    def holds(self) -> bool:
        starts = self.pairs.starts.numpy()
        return all(
            (self.owners.numpy()[starts[env] :][:count] == env).all()
            for env, count in enumerate(self.counts.numpy())
        )


def test_rooms_grow_within_the_arrays() -> None:
    """Captured graphs know these; who has entries beside keeps them, and nothing else."""
    asked, counts = np.full(64, 16), np.arange(64) % 17
    pairs = PairList(64, CPU, 24, 1000)
    append(pairs, asked)
    beside = Beside(pairs, counts)
    places = []
    for env, most in ((3, 30), (50, 25), (9, 32), (9, 300)):
        beside.write()
        asked[env] = most
        pairs.clear(wp.full(64, 1, dtype=wp.int32, device=CPU))
        append(pairs, asked)
        assert pairs.fit() and pairs.rooms[env] >= most and beside.holds()
        for other in range(64):
            listed = pairs.of(other, pairs.pairs)[: 24 if other == env else asked[other]]
            assert len(listed) >= 16 and (listed[:, 0] == other).all()
        assert len(pairs.pairs) == len(beside.owners) == pairs.capacity
        places.append((pairs.starts.ptr, pairs.pairs.ptr, beside.owners.ptr, pairs.moves))
    assert places[0] == places[1] == places[2] != places[3]
    kept_alive = weakref.ref(beside)
    del beside
    assert kept_alive() is None and not pairs.grow().any()


def test_entries_do_not_move_without_memory_for_a_second_array(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nor within the arrays: they move there by way of another one."""
    asked = np.full(64, 16)
    pairs = PairList(64, CPU, 24, 1000)
    asked[3] = 30
    append(pairs, asked)
    assert pairs.fit() and pairs.capacity > pairs.rooms.sum() + 20
    for free, room in ((7 * pairs.capacity, 24), (10 * pairs.capacity, 37)):
        monkeypatch.setattr(ragged_lists, "free_memory", lambda device, free=free: free)
        asked[9] = 25
        pairs.clear(wp.full(64, 1, dtype=wp.int32, device=CPU))
        append(pairs, asked)
        assert pairs.fit() == (room > 24) and pairs.rooms[9] == room


def test_places_are_counted_by_int32(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ragged_lists, "free_memory", lambda device: None)
    monkeypatch.setattr(PairList, "most_entries", 1000)
    pairs = PairList(2, CPU, 10, 1 << 20)
    append(pairs, np.array([700, 500]))
    # Environments whose list was too short are emptied, and ask for more.
    short = wp.zeros(2, dtype=wp.int32, device=CPU)
    wp.launch(_look_kernel, dim=2, inputs=[pairs.room, short], device=CPU)
    assert short.numpy().all() and grow_all([pairs]).tolist() == [True, False]
    assert pairs.rooms.tolist() == [10, 750]
