# SPDX-License-Identifier: Apache-2.0
"""Is the ball the one that is stated? What the colours say of its radius.

The map from slope to colour is free, so that the colours cannot tell a ball from a larger one that
is pressed less steeply: they bound the radius from below only. A ball that is too small cannot hold
the contacts (their radius ends at the ball's) and its slopes, steep towards the equator, do not fit
the gel beside the contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet
from taccel_lab.calibration.contacts.fit import FittedTogether
from taccel_lab.calibration.contacts.photometric import fit_contacts
from taccel_lab.calibration.contacts.remarks import WRONG_BALL_RADIUS
from taccel_lab.calibration.contacts.slope_law import MAX_CONTACT_RATIO
from taccel_lab.report.remark import Remark

FACTORS = (0.7, 0.85, 1.0, 1.2, 1.45, 1.75, 2.2)
"""Ball radii that are tried, over the stated one."""
ROUNDS = 8
MIN_PRESSES = 4
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
    """Smallest radius that the colours allow [mm]."""
    pinned: int
    """Presses whose contact is as large as the stated ball."""
    count: int

    @property
    def consistent(self) -> bool:
        """The stated radius is allowed."""
        return self.stated_mm >= self.lowest_mm and self.pinned <= self.count / 4

    def remarks(self, blocks: Sequence[str] = ()) -> list[Remark]:
        """That the radius is wrong, with figures; ``blocks`` are those that it concerns."""
        if self.consistent:
            return []
        at = self.tried_mm.index(self.stated_mm)
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
    circles = [contact.circle for contact in found.fit.contacts]
    sums, rms, pinned = [], [], 0
    for factor in FACTORS:
        fit = fit_contacts(
            found.samples,
            circles,
            [factor * ball for ball in found.ball_px],
            blur_px=found.fit.blur_px,
            iterations=ROUNDS,
        )
        sums.append(np.log(np.maximum(fit.sums_by_press, 1e-9)))
        rms.append(fit.rms_levels)
        if factor == 1.0:
            pinned = sum(
                contact.circle.radius_px > 0.99 * MAX_CONTACT_RATIO * ball
                for contact, ball in zip(fit.contacts, found.ball_px, strict=True)
            )
    stated = captures.ball_radius_mm
    return BallCheck(
        stated_mm=stated,
        tried_mm=tuple(stated if f == 1.0 else f * stated for f in FACTORS),
        rms_levels=tuple(rms),
        lowest_mm=stated * _lowest(np.array(sums)),
        pinned=pinned,
        count=len(circles),
    )


def _lowest(log_sums: np.ndarray) -> float:
    """Smallest factor whose residuals do not surely exceed the best ones, shape [factor, press].

    Between two factors that are tried, the rise is taken as linear.
    """
    best = int(np.argmin(log_sums.mean(axis=1)))
    rise = (log_sums - log_sums[best]) / 2  # of the residual, not of its square
    mean = rise.mean(axis=1)
    error = rise.std(axis=1, ddof=1) / np.sqrt(rise.shape[1])
    excess = np.minimum(mean - np.log1p(WORSE), mean - SURE * error)
    low = FACTORS[0]
    for k in range(best, 0, -1):
        if excess[k - 1] > 0:
            inside = max(-excess[k], 0.0)
            part = inside / max(inside + excess[k - 1], 1e-9)
            low = FACTORS[k] + part * (FACTORS[k - 1] - FACTORS[k])
            break
    return float(low)
