# SPDX-License-Identifier: Apache-2.0
"""Small steps on device arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import warp as wp

if TYPE_CHECKING:
    import torch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _negate_kernel(values: wp.array2d(dtype=wp.vec3d), result: wp.array2d(dtype=wp.vec3d)):
    i, j = wp.tid()
    result[i, j] = -values[i, j]


@wp.kernel
def _add_kernel(
    first: wp.array2d(dtype=wp.vec3d),
    second: wp.array2d(dtype=wp.vec3d),
    result: wp.array2d(dtype=wp.vec3d),
):
    i, j = wp.tid()
    result[i, j] = first[i, j] + second[i, j]


def negated(values: wp.array) -> wp.array:
    """Minus the vectors, vec3d, two axes."""
    result = wp.empty_like(values)
    wp.launch(
        _negate_kernel,
        dim=values.shape,
        inputs=[values],
        outputs=[result],
        device=values.device,
    )
    return result


def added(first: wp.array, second: wp.array) -> wp.array:
    """Sum of the vectors, vec3d, two axes."""
    result = wp.empty_like(first)
    wp.launch(
        _add_kernel,
        dim=first.shape,
        inputs=[first, second],
        outputs=[result],
        device=first.device,
    )
    return result


def to_torch(array: wp.array) -> torch.Tensor:
    """A tensor on the same memory; vectors and matrices become trailing axes."""
    return wp.to_torch(array, requires_grad=False)
