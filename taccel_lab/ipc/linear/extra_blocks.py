# SPDX-License-Identifier: Apache-2.0
"""Blocks of the Newton matrix outside of its fixed pattern: contact between two free bodies."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


class ExtraBlocks:
    """A list of blocks (row > column) per environment; several entries of one place add up."""

    def __init__(self, env_count: int, device: wp.Device, capacity: int = 1) -> None:
        self.counts = wp.zeros(env_count, dtype=wp.int32, device=device)
        self.max_count = 0
        self._device = device
        self._allocate(capacity)

    def _allocate(self, capacity: int) -> None:
        shape = (len(self.counts), capacity)
        self.places = wp.zeros(shape, dtype=wp.vec2i, device=self._device)
        """(row, column), shape [env_count, capacity]."""
        self.values = wp.zeros(shape, dtype=wp.mat33d, device=self._device)
        """Blocks [N/m], shape [env_count, capacity]."""

    def clear(self) -> None:
        """Forget all blocks."""
        self.counts.zero_()
        self.max_count = 0

    def overflowed(self) -> bool:
        """Read the counts back; when the list was too short make it long enough and say so."""
        self.max_count = int(self.counts.numpy().max())
        if self.max_count <= self.places.shape[1]:
            return False
        self._allocate(3 * self.max_count // 2)
        return True


@wp.func
def add_extra_product(
    count: int,
    places: wp.array(dtype=wp.vec2i),
    blocks: wp.array(dtype=wp.mat33d),
    x: wp.array(dtype=wp.vec3d),
    y: wp.array(dtype=wp.vec3d),
):
    """y += E x of one environment, both triangles."""
    for k in range(count):
        i = places[k][0]
        j = places[k][1]
        block = blocks[k]
        y[i] += block * x[j]
        # x * block = block^T x
        y[j] += x[i] * block
