# SPDX-License-Identifier: Apache-2.0
"""A contact circle moved to where a model of the image meets the image best."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.contacts.circle_arrays import circle_array, circle_of
from taccel_lab.calibration.robust_spread import spread_about_zero

Misfit = Callable[[ContactCircle], np.ndarray]
"""Modelled less seen levels at fixed pixels, were the contact this circle, shape [n]."""

ROBUST_LEVELS = 4.0
"""Residual above which one counts less, after Huber: scratches of the ball, dust [levels]."""
ROUNDS = 6
STEP_PX = 0.5
"""Of the finite differences over centre and radius."""
MAX_STEP_PX = 1.5
CONVERGED_PX = 0.05
MAX_DEVIATIONS = 3.0
"""A circle stays within this many standard deviations of what is known before."""


def refine_circle(
    misfit: Misfit,
    start: ContactCircle,
    prior: ContactCircle,
    prior_sigma_px: np.ndarray,
    share: float,
) -> ContactCircle:
    """Most probable circle by Gauss-Newton steps.

    Args:
        misfit: The model of the image; any may be taken.
        start: Circle to begin with.
        prior: What is known of the circle before.
        prior_sigma_px: Standard deviations of that, shape [3].
        share: Independent values that a residual counts as: neighbouring pixels err alike.
    """
    middle, p = circle_array([prior, start])
    known = np.diag(1 / prior_sigma_px**2)
    for _ in range(ROUNDS):
        r = misfit(circle_of(p))
        ahead = [(misfit(circle_of(p + step)) - r) / STEP_PX for step in STEP_PX * np.eye(3)]
        jacobian = np.stack(ahead, axis=-1)
        scale = max(1.0, spread_about_zero(r))
        weight = share / scale**2 / np.maximum(1.0, np.abs(r) / max(ROBUST_LEVELS, scale))
        normal = (jacobian * weight[:, None]).T @ jacobian + known
        gradient = jacobian.T @ (weight * r) + (p - middle) / prior_sigma_px**2
        step = np.clip(-np.linalg.solve(normal, gradient), -MAX_STEP_PX, MAX_STEP_PX)
        reach = MAX_DEVIATIONS * prior_sigma_px
        p = np.clip(p + step, middle - reach, middle + reach)
        if np.abs(step).max() < CONVERGED_PX:
            break
    return circle_of(p)
