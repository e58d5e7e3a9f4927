# SPDX-License-Identifier: Apache-2.0
"""Arrays of other libraries are taken, or refused in words."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.model.devices import require_device
from taccel_lab.model.env_rows import device_mask, given_array

CPU = wp.get_device("cpu")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda t: t.requires_grad_(),
            r"poses are a tensor with requires_grad.* tensor\.detach\(\)",
        ),
        (lambda t: t.requires_grad_() * 2, "poses are a tensor with requires_grad"),
        (lambda t: t.to_sparse(), "poses on the device must be dense numbers .*: .*layout"),
        (lambda t: t.to(torch.complex128), "poses on the device must be dense numbers .*complex"),
        (lambda t: t.to("meta"), "poses on the device must be dense numbers .*meta"),
    ],
)
def test_tensors_that_cannot_be_shared_are_refused_in_words(
    make: Callable[[torch.Tensor], torch.Tensor], words: str
) -> None:
    value = torch.zeros((2, 7), dtype=torch.float64)
    taken = given_array(value, "poses", (2,), wp.transformd, CPU)
    assert taken.ptr == value.data_ptr()
    with pytest.raises(InputError, match=words):
        given_array(make(value), "poses", (2,), wp.transformd, CPU)


def test_masks_alike() -> None:
    with pytest.raises(InputError, match="masks are a tensor with requires_grad"):
        device_mask(torch.zeros(2, requires_grad=True), 2, CPU)


@pytest.mark.parametrize("name", ["cuda:77", "gpu", "", "CPU", "cuda:x"])
def test_devices_that_are_not_there_are_refused_with_those_that_are(name: str) -> None:
    with pytest.raises(InputError, match=f"device '{name}' is not there; this machine has: cpu"):
        require_device(name)


def test_a_gpu_is_refused_where_there_is_none() -> None:
    if wp.is_cuda_available():
        assert require_device("cuda").is_cuda
        return
    with pytest.raises(InputError, match="device 'cuda' is not there; this machine has: cpu"):
        require_device("cuda")
