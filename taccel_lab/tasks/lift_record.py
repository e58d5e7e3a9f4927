# SPDX-License-Identifier: Apache-2.0
"""What becomes of an object that a hand grips and lifts, by environment."""

from __future__ import annotations

import numpy as np

from taccel_lab.files.strict_model import Number, StrictModel
from taccel_lab.tasks.parameters import Positive


class LiftGoal(StrictModel):
    """When it is done: so high over where it lay at the end, and for as long without a break."""

    lift_mm: Positive
    hold_s: Number


class LiftRecord:
    """Rise, slip in the grip, forces of the grip, and for how long it has been high."""

    def __init__(
        self, goal: LiftGoal, dt_s: float, rest_height_m: float | np.ndarray, shape: tuple[int, int]
    ) -> None:
        """
        Args:
            goal: Of the task.
            dt_s: Of a step.
            rest_height_m: Of the object's middle as it lies, or [env].
            shape: Numbers of environments and of gels.
        """
        count, _ = shape
        self._goal, self._dt_s, self._rest = goal, dt_s, rest_height_m
        self.gripping = np.zeros(count, dtype=bool)
        """Environments in which closing has ended, bool, [env]."""
        self.pushing = np.zeros(shape, dtype=bool)
        """Gels that pushed on the object when it ended, bool, [env, gel]."""
        self.grip_n = np.zeros(shape)
        """Forces of the gels on the object in the last step [N], [env, gel]."""
        self._weakest, self._strongest = np.full(count, np.nan), np.zeros(count)
        self._gripped_at = np.full((count, 3), np.nan)
        self._slip = np.full(count, np.nan)
        self._rise = np.zeros(count)
        self._held = np.zeros(count, dtype=int)

    def look(
        self,
        running: np.ndarray,
        begins: np.ndarray,
        middle_m: np.ndarray,
        raised_m: np.ndarray,
    ) -> None:
        """Take in a step, whose forces are in ``grip_n``.

        Args:
            running: Environments that took it, bool, [env].
            begins: Those in which closing ended with it, bool, [env].
            middle_m: Of the object, [env, 3].
            raised_m: How far the hand has risen, [env].
        """
        relative = middle_m - np.array([0.0, 0.0, 1.0]) * raised_m[:, None]
        self._gripped_at[begins] = relative[begins]
        self.pushing[begins] = self.grip_n[begins] > 0
        self.gripping |= begins
        holding = running & self.gripping
        slip = np.linalg.norm(relative - self._gripped_at, axis=1)
        self._slip[holding] = slip[holding]
        least = np.where(self.pushing, self.grip_n, np.inf).min(axis=1)
        least[~self.pushing.any(axis=1)] = 0.0
        self._weakest[holding] = np.fmin(self._weakest, least)[holding]
        strongest = np.maximum(self._strongest, self.grip_n.max(axis=1))
        self._strongest[running] = strongest[running]
        self._rise[running] = (middle_m[:, 2] - self._rest)[running]
        high = self._rise >= 1e-3 * self._goal.lift_mm
        self._held[running] = np.where(high, self._held + 1, 0)[running]

    @property
    def slip_m(self) -> np.ndarray:
        """How far the object has moved in the hand since the grip, NaN before, [env]."""
        return self._slip

    @property
    def done(self) -> np.ndarray:
        """Environments that meet the goal now, bool, [env]."""
        return self._held * self._dt_s >= self._goal.hold_s - 1e-9

    def figures(self, env: int) -> dict[str, float]:
        """Figures of an environment; of the grip by the gels that pushed when closing ended."""
        found = {
            "rise_mm": 1e3 * self._rise[env],
            "held_s": self._held[env] * self._dt_s,
            "slip_mm": 1e3 * self._slip[env],
            "weakest_grip_n": self._weakest[env],
            "strongest_grip_n": self._strongest[env],
        }
        return {name: float(value) for name, value in found.items()}

    def missed(self, env: int) -> str:
        """What of the goal an environment misses, empty if nothing."""
        if self._rise[env] < 1e-3 * self._goal.lift_mm:
            return f"rose by {1e3 * self._rise[env]:.1f} mm at the end"
        if not self.done[env]:
            return f"was held high for {self._held[env] * self._dt_s:.2f} s"
        return ""
