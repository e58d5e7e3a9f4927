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
from functools import cache

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet
from taccel_lab.calibration.circles.contact_finder import fit_together
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


def check_ball(captures: CaptureSet, blocks: Sequence[str] = ()) -> Remark | None:
    """Whether the colours of presses of one ball allow its stated radius: ``WRONG_BALL_RADIUS``, or
    ``BALL_FROM_BELOW`` where they do. None with fewer than 4 fitted presses.

    ``blocks`` are those that the remark concerns.
    """
    found, stated = fit_together(captures), captures.ball_radius_mm
    if found.fit is None or len(found.samples) < MIN_PRESSES:
        return None
    start, count = found.fit, len(found.samples)

    @cache
    def fitted(factor: float, sink_in: float) -> PhotometricFit:
        ball_px = [factor * ball for ball in found.ball_px]
        return fit_contacts(found.samples, start, ball_px, iterations=ROUNDS, sink_in=sink_in)

    def judged(fits: dict[float, PhotometricFit]) -> tuple[float, int]:
        """Smallest radius [mm] that the colours allow, and presses whose contact is as large as the
        stated ball."""
        contacts = zip(fits[1.0].contacts, found.ball_px, strict=True)
        largest = 0.99 * MAX_CONTACT_RATIO
        pinned = sum(contact.circle.radius_px > largest * ball for contact, ball in contacts)
        return stated * _lowest(fits), pinned

    fits = {factor: fitted(factor, SINK_IN_SCALE) for factor in FACTORS if factor >= 1.0}
    lowest, pinned = judged(fits)
    # Where larger balls allow the stated one, smaller ones cannot take that back.
    if stated < lowest or pinned > count / 4:
        # Contacts as wide as the ball speak against it whatever the gel does beside them.
        sink_ins = SINK_INS[:1] if pinned > count / 4 else SINK_INS
        fits = {
            factor: min((fitted(factor, one) for one in sink_ins), key=lambda fit: fit.rms_levels)
            for factor in FACTORS
        }
        lowest, pinned = judged(fits)
    if stated >= lowest and pinned <= count / 4:
        return BALL_FROM_BELOW(
            rms=fits[1.0].rms_levels,
            stated=stated,
            larger=FACTORS[-1] * stated,
            larger_rms=fits[FACTORS[-1]].rms_levels,
            blocks=blocks,
        )
    best = min(fits, key=lambda factor: fits[factor].rms_levels)
    return WRONG_BALL_RADIUS(
        rms=fits[1.0].rms_levels,
        stated=stated,
        best_rms=fits[best].rms_levels,
        best=best * stated,
        lowest=lowest,
        pinned=pinned,
        count=count,
        blocks=blocks,
    )


def _lowest(fits: dict[float, PhotometricFit]) -> float:
    """Smallest factor whose residuals do not surely exceed the best ones; factors rise.

    Between two factors that are tried, the rise is taken as linear.
    """
    factors = list(fits)
    log_sums = np.array([np.log(np.maximum(fit.sums_by_press, 1e-9)) for fit in fits.values()])
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
