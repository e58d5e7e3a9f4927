# SPDX-License-Identifier: Apache-2.0
"""Lists of environments: those of a mask, in launches of the list's size."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.model.env_lists import EnvList, ListedMask, mask_like, place_count
from taccel_lab.model.env_rows import copy_rows, zero_rows

CPU = wp.get_device("cpu")


def mask_of(*envs: int, count: int = 9) -> wp.array:
    mask = np.zeros(count, dtype=np.int32)
    mask[list(envs)] = 1
    return wp.array(mask, dtype=wp.int32, device=CPU)


def listed(places: int, *envs: int) -> tuple[EnvList, wp.array]:
    found, mask = EnvList(places, CPU), mask_of(*envs)
    found.fill(mask_of(0, 1))  # What was on it before is forgotten.
    found.fill(mask)
    return found, mask


@pytest.mark.parametrize("envs", [(), (8,), (0, 3, 4, 8)])
def test_a_launch_over_a_list_works_where_the_mask_says(envs: tuple[int, ...]) -> None:
    places, mask = listed(4, *envs)
    active = ListedMask(mask, places)
    assert sorted(places.listed.numpy()[: places.count.numpy()[0]]) == list(envs)
    assert (len(active), place_count(active), place_count(mask)) == (9, 4, 9)
    values = wp.array(np.ones((9, 3)), dtype=wp.float64, device=CPU)
    zero_rows(active, values)
    assert np.flatnonzero(~values.numpy().all(axis=1)).tolist() == list(envs)


def test_those_on_the_list_that_a_mask_leaves_out_stay() -> None:
    """A step of which one environment has ended since the list was made."""
    places, mask = listed(4, 1, 5, 7)
    result = wp.zeros((9, 2), dtype=wp.float64, device=CPU)
    among = mask_like(ListedMask(mask, places), mask_of(5, 7))
    copy_rows(among, wp.array(np.ones((9, 2)), dtype=wp.float64, device=CPU), result)
    assert np.flatnonzero(result.numpy().any(axis=1)).tolist() == [5, 7]
    assert mask_like(mask, mask_of(5)) is not mask


def test_no_more_are_listed_than_there_are_places() -> None:
    places, mask = listed(2, 1, 5, 7)
    values = wp.array(np.ones((9, 1)), dtype=wp.float64, device=CPU)
    zero_rows(ListedMask(mask, places), values)
    assert (values.numpy() == 0).sum() == 2
