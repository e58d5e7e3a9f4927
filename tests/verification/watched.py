# SPDX-License-Identifier: Apache-2.0
"""A scene whose every step has to converge without intersections or inversions."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from taccel_lab.scene import Scene
from taccel_lab.solvers import SolverConfig, SolverIPC, StepReport
from taccel_lab.state import initial_state
from tests.support.intersection import find_intersections


class Watched:
    """A scene that steps and is checked; bodies are told by name or number."""

    def __init__(
        self, scene: Scene, start: np.ndarray | None = None, dhat_m: float = 2e-5, **config: float
    ) -> None:
        self.model = scene.finalize()
        self.solver = SolverIPC(self.model, SolverConfig(dhat_m=dhat_m, **config))  # type: ignore[arg-type]
        self.state = initial_state(self.model, start)

    def step(self, poses: np.ndarray | None = None) -> StepReport:
        """One step, in which nothing may touch or cross."""
        report = self.solver.step(self.state, poses)
        assert report.converged.all(), report.summary()
        assert find_intersections(self.model, self.state) == [[]]
        assert report.min_distance_m[0] > 0
        return report

    def walk(self, path: Iterable[np.ndarray]) -> None:
        """A step to each of some poses."""
        for poses in path:
            self.step(poses)

    def _slice(self, body: int | str) -> slice:
        number = self.model.body_id(body) if isinstance(body, str) else body
        return self.model.bodies[number].node_slice

    def force(self, body: int | str) -> np.ndarray:
        """Contact force on a body [N]."""
        return -self.solver.contact_gradient.numpy()[0, self._slice(body)].sum(axis=0)

    def positions(self, body: int | str = 0) -> np.ndarray:
        """Of a body's nodes [m]."""
        return self.state.positions.numpy()[0, self._slice(body)]

    def self_contacts(self) -> int:
        """Collisions of a body with itself."""
        found = self.solver.collisions.snapshot(0)["stencils"]
        bodies = self.model.surface.node_bodies.numpy()
        return int((bodies[found[:, 0]] == bodies[found[:, 3]]).sum())
