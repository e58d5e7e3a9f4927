# SPDX-License-Identifier: Apache-2.0
"""Resolutions of a press: of the options, finer ones, and that of the press beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from taccel_lab.presses.path import PressPath
from taccel_lab.presses.physics import PressPhysics
from taccel_lab.scene import Ball, TriangleMesh

FEW_STEPS, ROUGHER = 6, 10.0
"""Steps beside a ball that rubs at most, and factor of the tolerance there."""

FINER = 2**0.5
"""Elements along a side over those of the level below."""


@dataclass(frozen=True)
class Resolution:
    """How much finer a press is than the options say."""

    mesh: float
    """Elements along a side over those of the options."""
    dhat: float
    """Contact range over that of the options."""
    steps: float
    """Steps over those of the options."""

    @classmethod
    def of(cls, level: int, remembers: bool = True) -> Resolution:
        """Resolution of a level; 0 is that of the options. Where the path does not matter
        (``remembers`` is False) finer levels keep its steps."""
        steps = 2.0**level if remembers or level < 0 else 1.0
        return cls(FINER**level, 2.0**-level, steps)

    @property
    def is_beside(self) -> bool:
        """Whether it stands below that of the options, and is nobody's result."""
        return self.mesh < 1

    def _hurries(self, shape: Ball | TriangleMesh, path: PressPath) -> bool:
        """Whether the force says nothing (``measured_press``) but what steps add: beside balls."""
        return self.is_beside and isinstance(shape, Ball) and path.is_straight_down

    def physics(
        self, physics: PressPhysics, shape: Ball | TriangleMesh, path: PressPath
    ) -> PressPhysics:
        """Return the physics of a press along a path."""
        rougher = ROUGHER if self._hurries(shape, path) else 1.0
        tolerance = rougher * physics.relative_tolerance
        return replace(physics, dhat_m=self.dhat * physics.dhat_m, relative_tolerance=tolerance)

    def path(
        self, path: PressPath, shape: Ball | TriangleMesh, friction: float, relaxes: bool
    ) -> PressPath:
        """Return a path in the steps of this resolution.

        What steps add needs few of them, and is the less the more there are: that of 3 and 6 of
        twenty is within 0.1 % of the force of that of 10 and 20.
        """
        path = path.with_steps(self.steps)
        if relaxes or not self._hurries(shape, path):
            return path
        count = sum(path.counts)
        few = min(count, FEW_STEPS) // 2 * 2 if friction > 0 else 1
        return path.with_steps(few / count)


AS_IT_IS = Resolution.of(0)
BESIDE = Resolution(1 / FINER, 1.0, 1.0)
"""Resolution of the press beside that."""
