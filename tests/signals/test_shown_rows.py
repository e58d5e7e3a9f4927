# SPDX-License-Identifier: Apache-2.0
"""Images that are read as graphs are those that are not, of whichever environments."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.benchmarks.measure import LaunchCounter
from taccel_lab.signals.shown_rows import ShownRows
from tests.signals.pressed_surface import flat_pad
from tests.signals.tactile_cases import DEVICES, ENV_COUNT, PAD_HALF_MM, make, on_device, presses

PAD = flat_pad(0.4, PAD_HALF_MM)
IMAGES = ("rgb", "rgb_levels", "height_m", "depth_m", "normals", "points_m")
CHOSEN = (None, [4], [0, 2, 3], None, [1, 4], [], [0, 1, 2, 3, 4], [3], None)


@pytest.mark.parametrize("device", DEVICES)
def test_captured_reads_are_plain_reads(device: str) -> None:
    """Whatever was read before, at positions that change where they are or are others."""
    random = np.random.default_rng(0)
    pressed = presses(PAD)
    places = [on_device(pressed, device), on_device(pressed[::-1].copy(), device)]
    poses = np.zeros((ENV_COUNT, 7))
    poses[:, 2], poses[:, 6] = 1e-4 * np.arange(ENV_COUNT), 1.0
    frames = [None, wp.array(poses, dtype=wp.transformd, device=device)]
    plain, captured = (make(PAD, device, capture=wanted) for wanted in (False, True))
    for turn in range(90):
        place = places[turn // 45]
        place.assign(random.permutation(pressed))
        chosen = CHOSEN[random.integers(len(CHOSEN))]
        who = None if chosen is None else np.isin(np.arange(ENV_COUNT), chosen)
        frame = frames[turn // 60]
        names = random.permutation(IMAGES)[: random.integers(1, 4)].tolist()
        for signal in (plain, captured):
            signal.update(place, frame, who)
        for name in names if turn % 2 else [names]:
            read = [name] if isinstance(name, str) else name
            for one, other in zip(plain.read(*read), captured.read(*read), strict=True):
                np.testing.assert_array_equal(one.numpy(), other.numpy())


@pytest.mark.parametrize("device", DEVICES)
def test_a_read_is_one_launch(device: str) -> None:
    place = on_device(presses(PAD), device)
    signal = make(PAD, device, capture=True)
    for turn in range(4):
        signal.update(place)
        with LaunchCounter() as launches:
            signal.read("rgb", "height_m")
        assert (launches.count == 1) == (turn > 1)


@pytest.mark.parametrize(("env_count", "most"), [(1, 1), (5, 5), (256, 8), (1000, 8)])
def test_there_are_few_numbers_of_rows(env_count: int, most: int) -> None:
    """Rows beyond those that are shown repeat the last one."""
    shown = ShownRows(env_count, wp.get_device("cpu"), chunk_envs=64)
    found = set()
    for count in range(1, env_count + 1):
        who = np.arange(env_count) >= env_count - count
        shown.show(who)
        rows = shown.rounded
        found.add(rows)
        assert shown.count == count <= rows <= min(env_count, count + -(-env_count // 8))
        parts = list(shown.chunks(rows))
        assert max(part.stop - part.start for part in parts) <= 64
        numbers = np.concatenate([shown.numbers[part].numpy() for part in parts])
        np.testing.assert_array_equal(numbers[:count], np.flatnonzero(who))
        assert (numbers[count:] == env_count - 1).all()
    assert len(found) <= most
    shown.show(None)
    assert shown.rounded == shown.count == env_count
    np.testing.assert_array_equal(shown.numbers.numpy(), np.arange(env_count))
