# SPDX-License-Identifier: Apache-2.0
"""Steps as captured graphs: recorded once for a state's arrays, then launched as a whole."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import warp as wp

from taccel_lab.solvers.solver_parts import SolverParts
from taccel_lab.solvers.step import take_step
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.state import State

_MOST = 2
"""Graphs that are kept, each for the arrays of one state."""


class StepGraphs:
    """Launches whole steps; the first one with new arrays as they come, to load its kernels."""

    def __init__(self, solver: SolverParts) -> None:
        self._solver = solver
        self._graphs: dict[tuple, wp.Graph | None] = {}
        self.launches = 0
        """Graphs launched so far."""

    def clear(self) -> None:
        """Forget all graphs: arrays that they use have moved."""
        self._graphs.clear()

    def launch(self, state: State) -> None:
        """Take a step of the environments in ``progress.who`` to ``end_poses``."""
        run = StepLaunches(self._solver, state)
        if not self._solver.config.capture:
            take_step(run)
            return
        s = self._solver
        # Lists that have grown since have moved, whoever made room in them.
        room = [part.capacity for part in s.lists]
        key = (s.load is not None, *room, *_pointers(state))
        if key not in self._graphs:
            if len(self._graphs) >= _MOST:
                self._graphs.pop(next(iter(self._graphs)))
            self._graphs[key] = None
            take_step(run)
            return
        graph = self._graphs[key]
        if graph is None:
            with wp.ScopedCapture(self._solver.model.device) as capture:
                take_step(run)
            graph = self._graphs[key] = capture.graph
        wp.capture_launch(graph)
        self.launches += 1


def _pointers(value: Any) -> tuple[int, ...]:
    """Addresses of all arrays of a state."""
    found: list[int] = []
    for field in fields(value):
        part = getattr(value, field.name)
        if isinstance(part, wp.array):
            found.append(part.ptr or 0)
        elif part is not None:
            found.extend(_pointers(part))
    return tuple(found)
