# SPDX-License-Identifier: Apache-2.0
"""Standard deviations that strangers among the values do not move.

P. J. Rousseeuw and C. Croux, "Alternatives to the median absolute deviation", 1993: the median of
absolute deviations of normal noise is 0.6745 standard deviations.
"""

from __future__ import annotations

import numpy as np

_SIGMAS = 0.6744897501960817
"""Upper quartile of the standard normal distribution."""


def spread_about_median(values: np.ndarray) -> float:
    """Standard deviation of normal noise about the values' median, of all values together."""
    return spread_about_zero(np.asarray(values) - np.median(values))


def spread_about_zero(values: np.ndarray) -> float:
    """Standard deviation of normal noise about zero, such as residuals have."""
    return float(np.median(np.abs(values))) / _SIGMAS
