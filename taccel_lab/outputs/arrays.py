# SPDX-License-Identifier: Apache-2.0
"""Small steps on device arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from taccel_lab.model.launches import launch
from taccel_lab.typed import typed

if TYPE_CHECKING:
    import torch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _negate_nodes_kernel(values: wp.array2d(dtype=wp.vec3d), result: wp.array2d(dtype=wp.vec3d)):
    i, j = wp.tid()
    result[i, j] = -values[i, j]


def negated(values: wp.array, into: wp.array | None = None) -> wp.array:
    """Minus the vectors, vec3d, two axes; written to ``into`` if that is given."""
    result = wp.empty_like(values) if into is None else into
    launch(_negate_nodes_kernel, values.shape, values, result)
    return result


@typed
def to_torch(array: wp.array) -> torch.Tensor:
    """Return a tensor on the same memory; vectors and matrices become trailing axes."""
    return wp.to_torch(array, requires_grad=False)


def shared(array: wp.array) -> Any:
    """The same memory for a library of arrays: numpy's on the host, where torch, which takes longer
    to load than a press to solve, is not needed; torch's on a GPU. Vectors become trailing axes."""
    return array.numpy() if array.device.is_cpu else to_torch(array)
