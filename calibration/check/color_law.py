# SPDX-License-Identifier: Apache-2.0
"""One law of colour for all presses: which ball each of them looks like, and what it does to the
others.

The change of colour over a contact is taken as a cubic of the ball's slopes, whose lower terms
differ over the picture linearly: what a few seconds allow of the colour model that is calibrated
later. The law is fitted to all presses but the one in question, those that it explains worst left
out. A press of another ball then fits better with slopes of that ball; and by how much worse a
press makes the law fit the others says whether it is worth leaving out. Both need no image again:
each press is a few sums of squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.check.frames import FrameFigures

DISC = 0.85
"""Part of the contact that is looked at: its rim has the slopes of the gel, not of the ball."""
FACTORS = np.exp(np.linspace(-np.log(2.5), np.log(2.5), 25))
"""Balls that are tried, over the stated one."""
_STEEPEST = 0.97
"""Slopes beyond this part of the ball's radius are those there: circles are off by a pixel."""
_TRUSTED = 0.8
"""Share of the presses, those best explained, that the law is fitted to."""
_ROUNDS = 3
_RIDGE = 1e-4


@dataclass(frozen=True)
class ApparentBall:
    """The ball that a press looks like."""

    factor: float
    """Of its radius, over the stated one."""
    gain: float
    """How many times less is unexplained with it than with the stated one."""

    @property
    def at_end(self) -> bool:
        """Whether no ball that is tried is far enough: a wrong circle, or hardly a contact."""
        return not FACTORS[0] * 1.01 < self.factor < FACTORS[-1] * 0.99


class ColorLaw:
    """The law of one set of presses."""

    def __init__(
        self,
        frames: Sequence[FrameFigures],
        circles: Sequence[ContactCircle],
        ball_px: Sequence[float],
        width_px: int,
    ) -> None:
        """``frames`` with their circles and their balls' radii in pixels; at least 8."""
        self._frames, self._circles, self._ball_px = frames, circles, ball_px
        self._width_px = width_px
        products = [self._products(*self._samples(i, 1.0)) for i in range(len(frames))]
        self._slopes = np.array([found[0] for found in products])
        self._mixed = np.array([found[1] for found in products])
        self._colors = np.array([found[2] for found in products])
        diagonal = np.diag(self._slopes.mean(axis=0))
        self._ridge = np.diag(_RIDGE * diagonal + 1e-9)
        self._trusted = np.ones(len(frames), dtype=bool)
        for _ in range(_ROUNDS):
            share = self._left(self._law(self._trusted)) / np.maximum(self._colors, 1e-9)
            self._trusted = share <= np.quantile(share, _TRUSTED)

    @staticmethod
    def _products(design: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Mean squares and products over the pixels, so that each press counts the same."""
        count = len(design)
        squares = float((change**2).sum())
        return design.T @ design / count, design.T @ change / count, squares / count

    def _samples(self, which: int, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """Terms of the law and changes of colour over a contact's disc, for a ball of ``factor``
        times the radius."""
        frame, circle = self._frames[which], self._circles[which]
        change = frame.thumb - frame.reference
        height, width = change.shape[:2]
        small = width / self._width_px
        u0, v0 = (circle.u_px + 0.5) * small - 0.5, (circle.v_px + 0.5) * small - 0.5
        v, u = np.mgrid[:height, :width]
        inside = np.hypot(u - u0, v - v0) <= max(DISC * circle.radius_px * small, 1.5)
        ball = self._ball_px[which] * small * factor
        x, y = (u[inside] - u0) / ball, (v[inside] - v0) / ball
        shorter = np.minimum(1.0, _STEEPEST / np.maximum(np.hypot(x, y), 1e-9))
        x, y = x * shorter, y * shorter
        across, down = u[inside] / width - 0.5, v[inside] / width - 0.5
        low = np.stack([x, y, x * x, x * y, y * y], axis=1)
        cubes = np.stack([x**3, x * x * y, x * y * y, y**3, np.ones_like(x)], axis=1)
        places = [low, cubes, low * across[:, None], low * down[:, None]]
        return np.concatenate(places, axis=1), change[inside].astype(np.float64)

    def _law(self, presses: np.ndarray) -> np.ndarray:
        """Fitted to these presses, bool [press]; shape [term, 3]."""
        slopes = self._slopes[presses].mean(axis=0) + self._ridge
        return np.linalg.solve(slopes, self._mixed[presses].mean(axis=0))

    def _left(self, law: np.ndarray) -> np.ndarray:
        """Mean square that a law leaves of each press [levels^2], shape [press]."""
        crossed = np.einsum("tc,ptc->p", law, self._mixed)
        squared = np.einsum("tc,pts,sc->p", law, self._slopes, law)
        return np.maximum(self._colors - 2.0 * crossed + squared, 0.0)

    def apparent_ball(self, which: int) -> ApparentBall:
        """By the law of the others."""
        others = self._trusted.copy()
        others[which] = False
        law = self._law(others)
        left = []
        for factor in FACTORS:
            design, change = self._samples(which, float(factor))
            left.append(float(((change - design @ law) ** 2).mean()))
        best = int(np.argmin(left))
        return ApparentBall(float(FACTORS[best]), left[len(FACTORS) // 2] / max(left[best], 1e-9))

    def influence(self, which: Sequence[int]) -> tuple[float, float]:
        """What is left of the other presses, root mean square of levels, by a law fitted to all
        presses and by one without ``which``."""
        everyone = np.ones(len(self._frames), dtype=bool)
        without = everyone.copy()
        without[list(which)] = False
        both = (self._left(self._law(kept))[without].mean() for kept in (everyone, without))
        with_them, without_them = (float(np.sqrt(left / 3.0)) for left in both)
        return with_them, without_them
