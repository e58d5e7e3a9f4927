# SPDX-License-Identifier: Apache-2.0
"""Pareto fronts and power laws of measurements."""

from __future__ import annotations

import numpy as np

NOISE = 0.05
"""Part by which times may differ and still count as equal."""


def is_on_front(costs: np.ndarray, errors: np.ndarray, noise: float = NOISE) -> np.ndarray:
    """Whether no other point is cheaper by more than ``noise`` and no worse; bool, [n].

    ``errors``: [n], or [n, criteria], of which none may be worse.
    """
    errors = errors.reshape(len(costs), -1)
    cheaper = costs[:, None] < (1 - noise) * costs
    no_worse = (errors[:, None] <= errors).all(axis=2)
    return np.logical_not((cheaper & no_worse).any(axis=0))


def power_law(sizes: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Exponent, and factor, of values = factor size^exponent, by least squares of logarithms."""
    exponent, constant = np.polyfit(np.log(sizes), np.log(values), 1)
    return float(exponent), float(np.exp(constant))
