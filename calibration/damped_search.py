# SPDX-License-Identifier: Apache-2.0
"""The one search of the fits here: damped Gauss-Newton steps within bounds.

Levenberg 1944, Marquardt 1963. Steps are measured in what each parameter does to the function, so
that no scales are asked for.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_STEPS = 100
_RESTING = 1e-9
"""Step of a parameter, over its curvature's standard deviation, below which a refused step ends
it."""

Expanded = tuple[float, np.ndarray, np.ndarray]
Expansion = Callable[[np.ndarray, float], Expanded]
"""A function of parameters [k]: its value (infinite where it has none), its gradient [k] and, as
Gauss and Newton have it, its curvature [k, k]. The derivatives are asked for where the value lies
below the second argument."""


def damped_search(
    expand: Expansion,
    start: np.ndarray,
    *,
    low: np.ndarray | float = -np.inf,
    high: np.ndarray | float = np.inf,
    moving: np.ndarray | None = None,
    least_gain: float = 0.0,
    relative_gain: float = 0.0,
) -> tuple[np.ndarray, float, bool]:
    """Parameters [k] of the least value, that value, and whether the search came to an end.

    Args:
        expand: The function.
        start: Parameters to start from, shape [k], where it is finite.
        low: Bounds of the parameters, shape [k].
        high: See ``low``.
        moving: Parameters that are not held, bool, shape [k]; all when left out.
        least_gain: A step that gains no more is the last.
        relative_gain: Likewise, as a part of the value.
    """
    theta = np.clip(np.array(start, dtype=np.float64), low, high)
    moves = np.ones(len(theta), dtype=bool) if moving is None else moving
    value, gradient, curvature = expand(theta, np.inf)
    damping = 1e-4
    for _ in range(_STEPS):
        outward = ((theta <= low) & (gradient > 0)) | ((theta >= high) & (gradient < 0))
        free = np.flatnonzero(moves & ~outward)
        if not len(free):
            return theta, value, True
        diagonal = np.diag(curvature)[free]
        # A parameter without influence has no curvature.
        scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-12 * diagonal.max() + 1e-300))
        scaled = curvature[np.ix_(free, free)] * np.outer(scale, scale)
        scaled[np.diag_indices(len(free))] += damping
        trial = theta.copy()
        trial[free] -= scale * np.linalg.solve(scaled, scale * gradient[free])
        trial = np.clip(trial, low, high)
        there = expand(trial, value)
        if there[0] < value:
            gain = value - there[0]
            theta, (value, gradient, curvature) = trial, there
            damping = max(0.1 * damping, 1e-13)
            if gain <= least_gain + relative_gain * abs(value):
                return theta, value, True
        elif (np.abs(trial - theta)[free] <= _RESTING * scale).all():
            return theta, value, True
        else:
            damping = max(10 * damping, 1e-3)
    return theta, value, False
