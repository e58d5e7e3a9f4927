# SPDX-License-Identifier: Apache-2.0
"""Scenes that are stepped: every step has to converge, in some nothing may cross."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from taccel_lab.geometry import TetMesh
from taccel_lab.scene import Element, Material, Scene, SoftBody, TimeStepping
from taccel_lab.solvers import SolverConfig, SolverIPC, StepReport
from taccel_lab.state import State, initial_state
from tests.support.blocks import everywhere
from tests.support.intersection import find_intersections

G = 9.81


def linear(mesh: TetMesh, material: Material = Material(1e5, 0.4), **options: Any) -> SoftBody:
    """A gel of linear tets."""
    return SoftBody(mesh, material, element=Element.LINEAR, **options)


def in_time(dt_s: float, g: float = G, **options: Any) -> TimeStepping:
    """Steps with inertia, gravity downwards."""
    return TimeStepping(False, dt_s, (0.0, 0.0, -g), **options)


class Stepped:
    """A scene with solver and state; arrays are copies, of environment 0, nodes of a body that is
    named by name or number, of all without."""

    def __init__(
        self, scene: Scene, *start: np.ndarray, config: Any = None, **settings: Any
    ) -> None:
        """``start``: a pose [7] of each kinematic body, or the array of all environments;
        ``settings``: of the solver where ``config`` is not given."""
        self.model = scene.finalize()
        self.solver = SolverIPC(self.model, config or SolverConfig(**settings))
        self.state: State = initial_state(self.model, self._poses(start))
        self.rest = self.model.rest_positions.numpy()[0]

    def _poses(self, poses: tuple[Any, ...]) -> Any:
        if poses and isinstance(poses[0], np.ndarray) and poses[0].ndim == 1:
            return everywhere(self.model.env_count, *poses)
        return poses[0] if poses else None

    def attempt(self, *target: Any, **who: Any) -> StepReport:
        """A step to ``target``, which is like ``start`` or a ``Control``."""
        return self.solver.step(self.state, self._poses(target), **who)

    def step(self, *target: Any, **who: Any) -> StepReport:
        """The same, which has to converge."""
        report = self.attempt(*target, **who)
        assert report.converged.all(), report.summary()
        return report

    def steps(self, count: int) -> None:
        for _ in range(count):
            self.step()

    def walk(self, path: Iterable[np.ndarray]) -> None:
        """A step to each of some poses."""
        for poses in path:
            self.step(poses)

    def nodes(self, body: int | str | None = None) -> slice:
        if body is None:
            return slice(None)
        return self.model.bodies[
            self.model.body_id(body) if isinstance(body, str) else body
        ].node_slice

    def x(self, body: int | str | None = None) -> np.ndarray:
        """Positions [m], shape [node, 3]."""
        return self.state.positions.numpy()[0, self.nodes(body)].copy()

    def contact(self, body: int | str | None = None) -> np.ndarray:
        """Contact forces on nodes [N], shape [node, 3]."""
        return -self.solver.contact_gradient.numpy()[0, self.nodes(body)]

    def friction(self, body: int | str | None = None) -> np.ndarray:
        """Friction forces on nodes [N], shape [node, 3]."""
        return -self.solver.friction_gradient.numpy()[0, self.nodes(body)]

    def force(self, body: int | str) -> np.ndarray:
        """Contact force on a body [N]."""
        return self.contact(body).sum(axis=0)

    def crossings(self) -> list[str]:
        """Bodies that cross or contain one another, or lie below a plane."""
        found = find_intersections(self.model, self.state)[0]
        return [f"{item.first} and {item.second}: {item.kind}" for item in found]

    def self_contacts(self) -> int:
        """Collisions of a body with itself."""
        found = self.solver.collisions.snapshot(0)["stencils"]
        bodies = self.model.surface.node_bodies.numpy()
        return int((bodies[found[:, 0]] == bodies[found[:, 3]]).sum())


class Watched(Stepped):
    """A scene in which nothing may touch or cross either; dhat is 20 um."""

    def __init__(
        self, scene: Scene, *start: np.ndarray, dhat_m: float = 2e-5, **settings: Any
    ) -> None:
        super().__init__(scene, *start, dhat_m=dhat_m, **settings)

    def step(self, *target: Any, **who: Any) -> StepReport:
        report = super().step(*target, **who)
        assert find_intersections(self.model, self.state) == [[]] * self.model.env_count
        assert report.min_distance_m[0] > 0
        return report
