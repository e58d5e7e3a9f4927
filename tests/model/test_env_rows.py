# SPDX-License-Identifier: Apache-2.0
"""Rows of environments, of arrays of any type; those of other libraries are taken or refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.model.env_rows import copy_rows, device_mask, given_array, zero_rows
from taccel_lab.model.launches import CapturedWork, require_device

CPU = wp.get_device("cpu")


@pytest.mark.parametrize("dtype", [wp.int32, wp.float64, wp.vec2i, wp.vec3d, wp.transformd])
@pytest.mark.parametrize("shape", [(3,), (3, 4)])
def test_rows_are_copied_and_cleared_where_asked(dtype: Any, shape: tuple[int, ...]) -> None:
    width = () if dtype in (wp.int32, wp.float64) else (wp.types.type_size(dtype),)
    values = np.arange(1, 1 + np.prod(shape + width)).reshape(shape + width)
    array = wp.array(values, dtype=dtype, device="cpu")
    mask = wp.array([1, 0, 1], dtype=wp.int32, device="cpu")
    copied = wp.zeros_like(array)
    copy_rows(mask, array, copied)
    zero_rows(mask, array)
    np.testing.assert_array_equal(copied.numpy()[[0, 2]], values[[0, 2]])
    np.testing.assert_array_equal(array.numpy()[1], values[1])
    assert not copied.numpy()[1].any() and not array.numpy()[[0, 2]].any()


def test_rows_of_several_types_are_copied_and_cleared_in_one_graph() -> None:
    """Without overloads: in a graph of the CPU the last of a kernel's stands for all."""
    kinds = (wp.vec3d, wp.int32)
    sources = [wp.full((3, 4), 7, dtype=dtype, device="cpu") for dtype in kinds]
    copied, cleared = ([wp.zeros_like(source) for source in sources] for _ in range(2))
    mask = wp.array([1, 0, 1], dtype=wp.int32, device="cpu")

    def work() -> None:
        for source, copy, clear in zip(sources, copied, cleared, strict=True):
            copy_rows(mask, source, copy)
            zero_rows(mask, clear)

    graph = CapturedWork(CPU)
    for _ in range(3):
        for copy, clear in zip(copied, cleared, strict=True):
            copy.zero_()
            clear.fill_(5)
        graph.launch("these", work)
        for copy, clear in zip(copied, cleared, strict=True):
            assert (copy.numpy()[[0, 2]] == 7).all() and not copy.numpy()[1].any()
            assert not clear.numpy()[[0, 2]].any() and (clear.numpy()[1] == 5).all()
    assert graph.launches == 2


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda t: t.requires_grad_(), r"poses are .* with requires_grad.* tensor\.detach\(\)"),
        (lambda t: t.requires_grad_() * 2, "poses are a tensor with requires_grad"),
        (lambda t: t.to_sparse(), "poses on the device must be dense numbers .*: .*layout"),
        (lambda t: t.to(torch.complex128), "poses on the device must be dense numbers .*complex"),
        (lambda t: t.to("meta"), "poses on the device must be dense numbers .*meta"),
    ],
)
def test_unshared_tensors_are_refused(make: Callable[..., torch.Tensor], words: str) -> None:
    value = torch.zeros((2, 7), dtype=torch.float64)
    taken = given_array(value, "poses", (2,), wp.transformd, CPU)
    assert taken.ptr == value.data_ptr()
    with pytest.raises(InputError, match=words):
        given_array(make(value), "poses", (2,), wp.transformd, CPU)


def test_masks_alike() -> None:
    with pytest.raises(InputError, match="masks are a tensor with requires_grad"):
        device_mask(torch.zeros(2, requires_grad=True), 2, CPU)


@pytest.mark.parametrize("name", ["cuda", "cuda:77", "gpu", "", "CPU", "cuda:x"])
def test_devices_that_are_not_there_are_refused_with_those_that_are(name: str) -> None:
    if name == "cuda" and wp.is_cuda_available():
        assert require_device("cuda").is_cuda
        return
    with pytest.raises(InputError, match=f"device '{name}' is not there; this machine has: cpu"):
        require_device(name)
