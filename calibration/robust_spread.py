# SPDX-License-Identifier: Apache-2.0
"""Standard deviations that strangers among the values do not move.

P. J. Rousseeuw and C. Croux, "Alternatives to the median absolute deviation", 1993: the median of
absolute deviations of normal noise is 0.6745 standard deviations.
"""

from __future__ import annotations

import numpy as np

_MEDIAN_LENGTHS = {1: 0.6744897501960817, 2: 1.1774, 3: 1.538}
"""Median length of a vector of this number of standard normal variables."""


def spread_about_median(values: np.ndarray) -> float:
    """Standard deviation of normal noise about the values' median, of all values together."""
    return spread_about_zero(np.asarray(values) - np.median(values))


def spread_about_zero(values: np.ndarray) -> float:
    """Standard deviation of normal noise about zero, such as residuals have."""
    return spread_of_lengths(np.abs(values), 1)


def spread_of_lengths(lengths: np.ndarray, dimensions: int) -> float:
    """Standard deviation along an axis of normal vectors of 1 to 3 dimensions, by their lengths."""
    return float(np.median(lengths)) / _MEDIAN_LENGTHS[dimensions]
