# SPDX-License-Identifier: Apache-2.0
"""How deep a ball went, from how large its contact is."""

from __future__ import annotations

import numpy as np

MAX_ROUNDS = 6
"""Depths tried for each press."""
FIRST_DEPTH_PER_CAP = 1.45
"""Depth over the height of the cap of that contact radius, to start the search: of a half-space
1.5 to 2, of a press as deep as the ball's radius about 1.4."""
DEEPEST_RADII = 1.2
"""The search does not go deeper than this many ball radii: beyond, the contact closes in under the
ball and its radius no longer grows."""
EQUATOR_SHARE = 0.985
"""Contact radius over the ball's from which on a press counts as one to the equator. What is seen
from behind ends at the equator, where the radius no longer tells the depth, so that larger circles
are taken as this large."""


class DepthSearch:
    """Secant search for the depths at which the contact radii meet their targets."""

    def __init__(self, target_mm: np.ndarray, ball_mm: float, tolerance_mm: float) -> None:
        self.target_mm = np.minimum(target_mm, EQUATOR_SHARE * ball_mm)
        self.tolerance_mm = tolerance_mm
        below = np.sqrt(ball_mm**2 - self.target_mm**2)
        self._limit_mm = DEEPEST_RADII * ball_mm
        self.depth_mm = np.minimum(FIRST_DEPTH_PER_CAP * (ball_mm - below), self._limit_mm)
        # Slope of depth over radius of the same rule, until two points give a better one.
        self._rule_slope = FIRST_DEPTH_PER_CAP * self.target_mm / below
        self._slope = self._rule_slope
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._rounds = 0
        self.radius_mm = np.zeros_like(self.target_mm)
        """Contact radii at the latest depths [mm]."""

    def update(self, radius_mm: np.ndarray) -> bool:
        """Take the radii found at ``depth_mm`` and set the next; True when all are met."""
        self._rounds += 1
        self.radius_mm = radius_mm
        error = self.target_mm - radius_mm
        done = np.abs(error) <= self.tolerance_mm
        if done.all() or self._rounds >= MAX_ROUNDS:
            return True
        if self._last is not None:
            step_depth, step_radius = self.depth_mm - self._last[0], radius_mm - self._last[1]
            # A measured radius carries noise of about the tolerance: between points that close the
            # secant is noise, and so is one far from the rule.
            usable = np.abs(step_radius) > 3 * self.tolerance_mm
            secant = step_depth / np.where(usable, step_radius, 1.0)
            good = usable & (secant > 0.3 * self._rule_slope) & (secant < 3 * self._rule_slope)
            self._slope = np.where(good, secant, self._slope)
        self._last = (self.depth_mm.copy(), radius_mm.copy())
        change = np.where(done, 0.0, self._slope * error)
        change = np.clip(change, -0.3 * self.depth_mm, 0.5 * self.depth_mm)
        self.depth_mm = np.clip(self.depth_mm + change, 0.0, self._limit_mm)
        return False
