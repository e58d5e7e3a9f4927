# SPDX-License-Identifier: Apache-2.0
"""Memory that several parts use in turn.

The blocks of the elements are among the largest that an environment needs, and they are idle once
they are gathered: the linear solver keeps in the same place what it needs during a solve alone.
"""

from __future__ import annotations

import math

import warp as wp

_ALIGNMENT = 256


class Scratch:
    """Hands out parts of an array as others; what does not fit is allocated."""

    def __init__(self, owner: wp.array | None = None) -> None:
        """``owner``: the memory to share; without one everything is allocated."""
        self._owner = owner
        self._used = 0

    def take(self, shape: tuple[int, ...], dtype: type, device: wp.Device) -> wp.array:
        """An array whose contents last until the owner, or who else shares it, is written."""
        size = math.prod(shape) * wp.types.type_size_in_bytes(dtype)
        if self._owner is None or self._used + size > self._owner.capacity:
            return wp.zeros(shape, dtype=dtype, device=device)
        pointer = self._owner.ptr + self._used
        self._used += -(-size // _ALIGNMENT) * _ALIGNMENT
        part = wp.array(ptr=pointer, dtype=dtype, shape=shape, device=device)
        # Keeps the memory alive.
        part._ref = self._owner
        return part
