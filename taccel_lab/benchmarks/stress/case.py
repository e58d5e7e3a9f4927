# SPDX-License-Identifier: Apache-2.0
"""What a case of the stress is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.model import Model
from taccel_lab.scene import Scene, TimeScheme
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import State


@dataclass(frozen=True)
class StressCase:
    """A scene, and what happens to it."""

    scene: Scene
    config: SolverConfig
    steps: int
    start: np.ndarray | None = None
    """Poses of the kinematic bodies at the start, [env_count, kinematic_count, 7]."""
    targets: Callable[[int], np.ndarray] | None = None
    """Poses at the end of step 0, 1, ...; where they are when None."""
    prepare: Callable[[SolverIPC, State, int], None] | None = None
    """Called before each step: sets loads or the targets of drives."""
    expect: Callable[[Model, State, int], str | None] | None = None
    """A referee of the family itself: says what is wrong after step 0, 1, ..., or None."""
    possible: bool = True
    """Whether every step has an answer; where not, a step that fails with a cause is right."""
    closed: bool = False
    """Nothing does work on the bodies: with implicit Euler their energy must not rise."""

    @classmethod
    def along(
        cls, path: Sequence[np.ndarray], scene: Scene, config: SolverConfig, possible: bool = True
    ) -> StressCase:
        """Kinematic bodies go along a path of poses [env_count, kinematic_count, 7]: the start, and
        the target of each step."""
        steps = len(path) - 1
        return cls(scene, config, steps, path[0], lambda i: path[i + 1], possible=possible)

    @property
    def watches_energy(self) -> bool:
        """Whether a rise of the energy is a fault."""
        return self.closed and self.scene.time.scheme is TimeScheme.EULER
