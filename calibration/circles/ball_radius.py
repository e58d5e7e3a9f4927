# SPDX-License-Identifier: Apache-2.0
"""Is the ball the one that is stated? What the colours say of its radius.

The map from slope to colour is free, so that the colours cannot tell a ball from a larger one that
is pressed less steeply: they bound the radius from below only. A ball that is too small cannot hold
the contacts (their radius ends at the ball's) and its slopes, steep towards the equator, do not fit
the gel beside the contact. A gel that sinks in otherwise than the law says does not fit there
either: before a ball is called wrong, each has had the sink-in that suits it best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet
from taccel_lab.calibration.circles.contact_finder import FittedTogether
from taccel_lab.calibration.circles.joint_fit import PhotometricFit, fit_contacts
from taccel_lab.calibration.circles.remarks import BALL_FROM_BELOW, WRONG_BALL_RADIUS
from taccel_lab.calibration.circles.slope_law import MAX_CONTACT_RATIO, SINK_IN_SCALE
from taccel_lab.calibration.circles.uncertainty import OTHER_SINK_IN_SCALE
from taccel_lab.report.remark import Remark

FACTORS = (0.7, 0.85, 1.0, 1.2, 1.45, 1.75, 2.2)
"""Ball radii that are tried, over the stated one."""
ROUNDS = 5
MIN_PRESSES = 4
SINK_INS = (SINK_IN_SCALE, SINK_IN_SCALE**2 / OTHER_SINK_IN_SCALE, OTHER_SINK_IN_SCALE)
"""Damping lengths of the gel beside a contact: the usual one and both sides of it."""
WORSE = 0.08
"""Rise of the residual that our model of the sink-in does not explain: on real presses of balls of
known radius the residual changes by up to 8 % between the stated radius and twice that."""
SURE = 3.0
"""Standard errors, over the presses, that a rise has to have."""


@dataclass(frozen=True)
class BallCheck:
    """Residual of the joint fit against the ball's radius."""

    stated_mm: float
    tried_mm: tuple[float, ...]
    rms_levels: tuple[float, ...]
    """Residual of the joint fit with each radius [levels]."""
    lowest_mm: float
    """Smallest radius of those tried that the colours allow [mm]; none below the stated one are
    tried where that is allowed."""
    pinned: int
    """Presses whose contact is as large as the stated ball."""
    count: int

    @property
    def consistent(self) -> bool:
        """The stated radius is allowed."""
        return self.stated_mm >= self.lowest_mm and not self.is_too_narrow

    @property
    def is_too_narrow(self) -> bool:
        """Many contacts are as wide as the stated ball."""
        return self.pinned > self.count / 4

    def remarks(self, blocks: Sequence[str] = ()) -> list[Remark]:
        """That the radius is wrong, with figures, or that nothing bounds it from above; ``blocks``
        are those that it concerns."""
        at = self.tried_mm.index(self.stated_mm)
        if self.consistent:
            return [
                BALL_FROM_BELOW(
                    rms=self.rms_levels[at],
                    stated=self.stated_mm,
                    larger=self.tried_mm[-1],
                    larger_rms=self.rms_levels[-1],
                    blocks=blocks,
                )
            ]
        best = int(np.argmin(self.rms_levels))
        return [
            WRONG_BALL_RADIUS(
                rms=self.rms_levels[at],
                stated=self.stated_mm,
                best_rms=self.rms_levels[best],
                best=self.tried_mm[best],
                lowest=self.lowest_mm,
                pinned=self.pinned,
                count=self.count,
                blocks=blocks,
            )
        ]


def check_ball(captures: CaptureSet, found: FittedTogether) -> BallCheck | None:
    """Fit the presses again with other balls; None with fewer than 4 fitted presses."""
    if found.fit is None or len(found.samples) < MIN_PRESSES:
        return None
    start = found.fit

    @cache
    def fitted(factor: float, sink_in: float) -> PhotometricFit:
        ball_px = [factor * ball for ball in found.ball_px]
        return fit_contacts(found.samples, start, ball_px, iterations=ROUNDS, sink_in=sink_in)

    def best(factor: float, sink_ins: Sequence[float]) -> PhotometricFit:
        return min((fitted(factor, one) for one in sink_ins), key=lambda fit: fit.rms_levels)

    fits = {factor: fitted(factor, SINK_IN_SCALE) for factor in FACTORS if factor >= 1.0}
    check = _judged(captures.ball_radius_mm, found.ball_px, fits)
    if check.consistent:
        # Smaller balls cannot take that back: the lowest one allowed would only be lower.
        return check
    # Contacts as wide as the ball speak against it whatever the gel does beside them.
    sink_ins = SINK_INS[:1] if check.is_too_narrow else SINK_INS
    fits = {factor: best(factor, sink_ins) for factor in FACTORS}
    return _judged(captures.ball_radius_mm, found.ball_px, fits)


def _judged(
    stated_mm: float, ball_px: Sequence[float], fits: dict[float, PhotometricFit]
) -> BallCheck:
    """What fits with the stated ball and others say, factors rising."""
    sums = np.array([np.log(np.maximum(fit.sums_by_press, 1e-9)) for fit in fits.values()])
    stated = zip(fits[1.0].contacts, ball_px, strict=True)
    largest = 0.99 * MAX_CONTACT_RATIO
    return BallCheck(
        stated_mm=stated_mm,
        tried_mm=tuple(stated_mm if f == 1.0 else f * stated_mm for f in fits),
        rms_levels=tuple(fit.rms_levels for fit in fits.values()),
        lowest_mm=stated_mm * _lowest(list(fits), sums),
        pinned=sum(contact.circle.radius_px > largest * ball for contact, ball in stated),
        count=len(ball_px),
    )


def _lowest(factors: Sequence[float], log_sums: np.ndarray) -> float:
    """Smallest factor whose residuals do not surely exceed the best ones, shape [factor, press].

    Between two factors that are tried, the rise is taken as linear.
    """
    best = int(np.argmin(log_sums.mean(axis=1)))
    rise = (log_sums - log_sums[best]) / 2  # of the residual, not of its square
    mean = rise.mean(axis=1)
    error = rise.std(axis=1, ddof=1) / np.sqrt(rise.shape[1])
    excess = np.minimum(mean - np.log1p(WORSE), mean - SURE * error)
    low = factors[0]
    for k in range(best, 0, -1):
        if excess[k - 1] > 0:
            inside = max(-excess[k], 0.0)
            part = inside / max(inside + excess[k - 1], 1e-9)
            low = factors[k] + part * (factors[k - 1] - factors[k])
            break
    return float(low)
