# SPDX-License-Identifier: Apache-2.0
"""Orders of a step: masks and targets reach the device together, alone, and after a loss."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.solvers.step_orders import StepOrders

CUDA = [
    pytest.mark.gpu,
    pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device"),
]
DEVICES = ["cpu", pytest.param("cuda:0", marks=CUDA)]


def held(orders: StepOrders) -> dict[str, list[int]]:
    return {name: mask.numpy().tolist() for name, mask in orders.masks.items()}


@pytest.mark.parametrize("device", DEVICES)
def test_masks_and_targets_arrive_together_and_alone(device: str) -> None:
    orders = StepOrders(3, 2, wp.get_device(device))
    targets = np.arange(42.0).reshape(3, 2, 7)
    orders.tell("reads", np.array([True, False, True]))
    orders.tell("again", np.array([False, True, False]))
    orders.aim(targets)
    orders.send()
    none = [0, 0, 0]
    told = {"who": none, "reads": [1, 0, 1], "writes": none, "again": [0, 1, 0], "ahead": none}
    assert held(orders) == told
    assert orders.targets.shape == (3, 2)
    np.testing.assert_array_equal(orders.targets.numpy().reshape(3, 2, 7), targets)
    # Each alone leaves the other as it is.
    orders.aim(targets + 1.0)
    orders.send()
    orders.tell("again", np.zeros(3, dtype=bool))
    orders.send()
    assert held(orders) == told | {"again": [0, 0, 0]}
    np.testing.assert_array_equal(orders.targets.numpy().reshape(3, 2, 7), targets + 1.0)


@pytest.mark.parametrize("device", DEVICES)
def test_targets_of_the_device_are_not_overwritten_by_older_ones_of_the_host(device: str) -> None:
    orders = StepOrders(2, 1, wp.get_device(device))
    newer = np.full((2, 1, 7), 3.0)
    orders.aim(np.ones((2, 1, 7)))
    orders.aim(wp.array(newer, dtype=wp.transformd, shape=(2, 1), device=device))
    orders.tell("who", np.array([True, True]))
    orders.send()
    np.testing.assert_array_equal(orders.targets.numpy().reshape(2, 1, 7), newer)
    assert held(orders)["who"] == [1, 1]


@pytest.mark.parametrize("device", DEVICES)
def test_what_may_have_been_lost_is_told_again(device: str) -> None:
    """A mask that the device has not got, as a copy was interrupted."""
    orders = StepOrders(2, 0, wp.get_device(device))
    mask = np.array([True, False])
    orders.tell("who", mask)
    orders.send()
    if device != "cpu":
        orders.masks["who"].zero_()
        orders.tell("who", mask)
        orders.send()
        assert held(orders)["who"] == [0, 0]
    orders.repeat()
    orders.tell("who", mask)
    orders.send()
    assert held(orders)["who"] == [1, 0]
