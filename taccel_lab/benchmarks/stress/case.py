# SPDX-License-Identifier: Apache-2.0
"""What a case of the stress is: parameters drawn from a seed, each kept by name for the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar
from zlib import crc32

import numpy as np

from taccel_lab.model import Model
from taccel_lab.scene import Scene, TimeScheme
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import State

Option = TypeVar("Option")


class Draw:
    """Draws of one case. The same family and seed give the same values in every run."""

    def __init__(self, family: str, seed: int) -> None:
        self._random = np.random.default_rng([crc32(family.encode()), seed])
        self.values: dict[str, Any] = {}
        """What was drawn, in order."""

    def _keep(self, name: str, value: Any) -> Any:
        if name in self.values:
            raise ValueError(f"{name!r} is drawn twice")
        self.values[name] = value
        return value

    def between(self, name: str, low: float, high: float) -> float:
        """Evenly from low to high."""
        return self._keep(name, float(self._random.uniform(low, high)))

    def decades(self, name: str, low: float, high: float) -> float:
        """Evenly in the logarithm."""
        exponent = self._random.uniform(np.log10(low), np.log10(high))
        return self._keep(name, float(10.0**exponent))

    def whole(self, name: str, low: int, high: int) -> int:
        """A whole number, both ends included."""
        return self._keep(name, int(self._random.integers(low, high + 1)))

    def choose(self, name: str, options: Sequence[Option]) -> Option:
        """One of a few things, which print well."""
        return self._keep(name, options[int(self._random.integers(len(options)))])

    def chance(self, name: str, probability: float) -> bool:
        """True in that part of all seeds."""
        return self._keep(name, bool(self._random.uniform() < probability))

    def direction(self, name: str) -> np.ndarray:
        """A unit vector, shape [3]; kept as rounded text, as what the seed gives is long."""
        vector = self._random.normal(size=3)
        vector /= np.linalg.norm(vector)
        self._keep(name, " ".join(f"{value:.3f}" for value in vector))
        return vector

    def rotation(self, name: str) -> np.ndarray:
        """A unit quaternion x, y, z, w."""
        vector = self._random.normal(size=4)
        vector /= np.linalg.norm(vector)
        self._keep(name, " ".join(f"{value:.3f}" for value in vector))
        return vector

    def seed(self, name: str) -> int:
        """A seed for somebody else's random numbers."""
        return self.whole(name, 0, 2**31 - 1)


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
