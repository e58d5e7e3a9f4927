# SPDX-License-Identifier: Apache-2.0
"""Arrays of users and tensors of a device: functions take either and give back what they got."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    import torch

Array = TypeVar("Array", np.ndarray, "torch.Tensor")
Given = TypeVar("Given", np.ndarray, "torch.Tensor")


def tensor_of(
    values: np.ndarray | torch.Tensor,
    dtype: torch.dtype | None = None,
    like: torch.Tensor | None = None,
) -> torch.Tensor:
    """The values as a tensor: an array on the CPU, or on the device of ``like``, without a copy
    where none is needed."""
    import torch

    device = None if like is None else like.device
    return torch.as_tensor(values, dtype=dtype, device=device)


def as_given(found: torch.Tensor, given: Array) -> Array:
    """A result as an array where ``given`` was one, as a tensor otherwise."""
    return cast(Array, found.cpu().numpy() if isinstance(given, np.ndarray) else found)


def length2(vectors: torch.Tensor) -> torch.Tensor:
    """Length of vectors of two components, shape [..., 2] to [...]; ten times as fast on a CPU as
    the norm along so short an axis."""
    import torch

    return torch.hypot(vectors[..., 0], vectors[..., 1])


def map_totals(maps: Any) -> Any:
    """Sums over rows and columns of maps, shape [..., h, w] to [..., 1, 1]; by rows first: the same
    to the bit for any number of maps and of threads."""
    return maps.sum(-1, keepdims=True).sum(-2, keepdims=True)


def require_device(name: str) -> None:
    """InputError unless torch has the device on this machine."""
    if name == "cpu":
        return
    import torch

    found = ["cpu", *(f"cuda:{k}" for k in range(torch.cuda.device_count()))]
    if name not in ("cuda", *found) or (name == "cuda" and len(found) == 1):
        raise InputError(f"device {name!r} is not here; devices of torch are {', '.join(found)}")


def layer_tensors(weights: Mapping[str, np.ndarray]) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """(weight, bias) of each layer of a network; members, where it has some, first."""
    import torch

    return [
        (torch.from_numpy(weights[f"layer{i}.weight"]), torch.from_numpy(weights[f"layer{i}.bias"]))
        for i in range(len(weights) // 2)
    ]
