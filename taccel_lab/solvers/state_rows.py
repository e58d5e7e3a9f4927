# SPDX-License-Identifier: Apache-2.0
"""A user's state read into the arrays that a solver works on, and written back, by environments.

One launch moves all arrays. Where they are stands in device memory, so that a captured step serves
every state: another one costs a copy of a dozen addresses.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from taccel_lab.model import Model
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False})

_MOST = 13
"""Arrays of a state, at most."""


@wp.kernel
def _move_rows_kernel(
    mask: wp.array(dtype=wp.int32),
    also: wp.array(dtype=wp.int32),
    lanes: int,
    count: int,
    widths: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.uint64),
    targets: wp.array(dtype=wp.uint64),
):
    """Rows of the first ``count`` arrays, of the environments of both masks."""
    env, lane = wp.tid()
    if mask[env] == 0 or also[env] == 0:
        return
    for k in range(count):
        width = widths[k]
        shape = (mask.shape[0], width)
        source = wp.array(ptr=sources[k], shape=shape, dtype=wp.float64)
        target = wp.array(ptr=targets[k], shape=shape, dtype=wp.float64)
        for i in range(lane, width, lanes):
            target[env, i] = source[env, i]


def _addresses(arrays: list[wp.array]) -> list[int]:
    return [array.ptr or 0 for array in arrays]


class StateRows:
    """Moves rows between a solver's ``work`` and the state that it was pointed at last."""

    def __init__(self, model: Model, work: State) -> None:
        self._model, self._work = model, work
        device = model.device
        self._widths = wp.zeros(_MOST, dtype=wp.int32, device=device)
        self._mine = wp.zeros(_MOST, dtype=wp.uint64, device=device)
        self._theirs = wp.zeros(_MOST, dtype=wp.uint64, device=device)
        self._known: tuple[list[int], list[int]] = ([], [])
        self._lanes = lane_count(device, model.env_count, 3 * model.node_count)

    def point(self, state: State) -> bool:
        """Move to and from ``state`` from now on; returns whether ``work`` has other arrays now,
        so that a graph that moves them is stale."""
        loads = (state.external_forces, state.wrenches, self._work.external_forces)
        if any(array is not None for array in loads):
            state.loads(self._model)
            self._work.loads(self._model)
        mine = [*self._work.motion(), *self._work.asked()]
        addresses = _addresses(mine), _addresses([*state.motion(), *state.asked()])
        changed = addresses[0] != self._known[0]
        if addresses != self._known:
            # Of no state while it is written: that may be interrupted.
            self._known = ([], [])
            entries = [wp.types.type_size_in_bytes(array.dtype) // 8 for array in mine]
            widths = [n * math.prod(a.shape[1:]) for n, a in zip(entries, mine, strict=True)]
            rows = (np.array(widths, dtype=np.int32), *np.array(addresses, dtype=np.uint64))
            for array, row in zip((self._widths, self._mine, self._theirs), rows, strict=True):
                array.assign(np.pad(row, (0, _MOST - len(row))))
            self._known = addresses
        return changed

    def read(self, mask: wp.array) -> None:
        """Reads into ``work`` in the environments of ``mask``, int32, [env_count]."""
        count = len(self._work.motion()) + len(self._work.asked())
        self._move(mask, mask, count, self._theirs, self._mine)

    def write(self, mask: wp.array, also: wp.array) -> None:
        """What steps change, from ``work``, in the environments of both masks, int32, [env_count]:
        in one launch, so that no interrupt leaves a half of it."""
        self._move(mask, also, len(self._work.motion()), self._mine, self._theirs)

    def _move(
        self, mask: wp.array, also: wp.array, count: int, sources: wp.array, targets: wp.array
    ) -> None:
        inputs = [mask, also, self._lanes, count, self._widths, sources, targets]
        launch(_move_rows_kernel, (self._model.env_count, self._lanes), *inputs)
