# SPDX-License-Identifier: Apache-2.0
"""Environments put back to where they start: a learning loop does it at every step, so that it is
one graph, which asks nothing of the host but who begins and in which poses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.potentials.joints import JointPotential
from taccel_lab.model import Model
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.env_rows import checked_mask, device_mask, on_device
from taccel_lab.model.kinematics import place_at_start
from taccel_lab.model.launches import CapturedWork
from taccel_lab.state import State, initial_state


class Starts:
    """The initial state of a model, and the launches that take environments there."""

    def __init__(self, model: Model, joints: JointPotential | None, captured: bool) -> None:
        self._model, self._joints = model, joints
        self._graph = CapturedWork(model.device, captured)
        start = initial_state(model)
        self._poses = start.poses
        """Poses to start in, transformd, [env_count, kinematic_count]."""
        self._start = replace(start.shared(), poses=self._poses)
        self.mask = wp.zeros(model.env_count, dtype=wp.int32, device=model.device)
        """Environments that the next ``put`` takes there."""

    def choose(self, mask: Any) -> None:
        """Set ``mask``, as ``device_mask`` takes it.

        Raises:
            InputError: Of another shape, type or device.
        """
        count, device = len(self.mask), self.mask.device
        if on_device(mask):
            wp.copy(self.mask, device_mask(mask, count, device))
        else:
            self.mask.assign(checked_mask(mask, count).astype(np.int32))

    def put(self, state: State, poses: wp.array) -> None:
        """Take the environments of ``mask`` in ``state`` to the start, in ``poses``: transformd,
        [env_count, kinematic_count]."""
        wp.copy(self._poses, poses)
        state.complete(self._model)
        assert state.unsearched is not None
        addresses = (array.ptr for array in (*state.motion(), state.unsearched))
        self._graph.launch((self._model.moves, *addresses), lambda: self._launch(state))
        state.searched = False

    def _launch(self, state: State) -> None:
        state.restore(self._start, self.mask)
        place_at_start(self._model, state.poses, state.positions, self.mask)
        embed_vertices(self._model, state.positions)
        if self._joints is not None:
            self._joints.reset(self.mask)
