# SPDX-License-Identifier: Apache-2.0
"""Pressure that a gel that relaxes adds to that of its relaxed layer, from frame to frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


class Overstress:
    r"""Pressure that a gel that relaxes adds to that of its relaxed layer, from frame to frame.

    With Poisson's ratio constant, space and time part: pressure p(t) of a surface whose relaxed
    layer would need p_e(t) is p_e plus, for each Maxwell branch g, tau [the correspondence
    principle: Christensen 1982, Theory of Viscoelasticity, 2.4],

        q(t) = g \int exp(-(t - s) / tau) dp_e(s)

    which from frame to frame, p_e even in between, is a recursion of one map a branch:

        q  <-  exp(-h) q + g (1 - exp(-h)) / h (p_e - p_e before),  h = dt / tau

    A first frame does not say how long it was held: q is between 0 and g p_e. What is not known
    fades by exp(-h) too.
    """

    def __init__(self, branches: Sequence[tuple[float, float]]) -> None:
        """``branches``: relative modulus and time [s] of each."""
        self.branches = tuple(branches)
        self._maps: list[np.ndarray] = []
        self._unknown: list[float] = []
        self._last: tuple[np.ndarray, float] | None = None

    @property
    def most(self) -> float:
        """Largest overstress over the relaxed pressure."""
        return sum(modulus for modulus, _ in self.branches)

    def follow(self, relaxed: np.ndarray, time_s: float | None) -> tuple[np.ndarray, float]:
        """Take the next frame.

        Args:
            relaxed: Pressure that the relaxed layer needs, any unit, [h, w].
            time_s: When the frame was taken, later than the one before [s]. None where that is not
                known: the frame is taken as a first one.

        Returns:
            The overstress, [h, w], and how far its sum may be from that either way.
        """
        if time_s is None or self._last is None or not time_s > self._last[1]:
            self._maps = [0.5 * modulus * relaxed for modulus, _ in self.branches]
            self._unknown = [float(q.sum()) for q in self._maps]
        else:
            before, at = self._last
            change = relaxed - before
            for number, (modulus, tau) in enumerate(self.branches):
                h = (time_s - at) / tau
                left = math.exp(-h)
                grown = -math.expm1(-h) / h
                self._maps[number] = left * self._maps[number] + modulus * grown * change
                self._unknown[number] *= left
        self._last = None if time_s is None else (relaxed, time_s)
        return np.sum(self._maps, axis=0), sum(self._unknown)
