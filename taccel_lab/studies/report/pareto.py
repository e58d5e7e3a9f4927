# SPDX-License-Identifier: Apache-2.0
"""Designs that no other design beats in every respect."""

from __future__ import annotations

import numpy as np


def pareto_front(costs: np.ndarray) -> np.ndarray:
    """Rows that no other row dominates, as a mask, shape [design].

    Row a dominates b when it is nowhere worse and somewhere better. Equal rows do not dominate each
    other. Rows with NaN are on no front.

    Args:
        costs: Less is better, shape [design, metric].
    """
    costs = np.asarray(costs, dtype=np.float64)
    known = np.array(np.isfinite(costs).all(axis=1))
    front = np.array(known)
    for row in np.flatnonzero(known):
        others = costs[known]
        no_worse = (others <= costs[row]).all(axis=1)
        better = (others < costs[row]).any(axis=1)
        front[row] = not (no_worse & better).any()
    return front
