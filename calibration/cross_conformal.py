# SPDX-License-Identifier: Apache-2.0
"""How wide a radius must be to hold a share of the errors of presses that were not seen.

Errors of the inverse model are not normal: a radius of 2.45 standard deviations holds 90 to 93 % of
them on real presses, not 95 %. The factor is found on presses as cross-conformal prediction finds
it (V. Vovk, Cross-conformal predictors, Ann. Math. Artif. Intell. 74, 2015; R. F. Barber et al.,
Predictive inference with the jackknife+, Ann. Stat. 49, 2021): the error of the member that left a
press out, over what the finished ensemble expects there. A single member errs more than the
ensemble, which makes the radius rather too wide than too narrow.

Pixels of one press err together, so presses weigh alike, and the quantile is the one at which
presses, each judged by the others alone, have the share wanted: a few presses need a higher one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

HIGHEST_LEVEL = 0.995
LEVELS = 46
MIN_PRESSES = 4
"""Fewest presses: with fewer, nothing is known of how presses differ."""


def radius_factor(scores: Sequence[np.ndarray], share: float, otherwise: float) -> float:
    """Factor on the expected error that holds ``share`` of the errors of a new press.

    Args:
        scores: Errors over expected errors of the pixels of each left-out press, shape [n] each.
        share: Share of a press's pixels that the radius should hold.
        otherwise: The factor where too few presses tell.
    """
    presses = [np.sort(score) for score in scores if len(score)]
    if len(presses) < MIN_PRESSES:
        return otherwise
    levels = np.linspace(share, HIGHEST_LEVEL, LEVELS)
    held = np.empty((len(presses), LEVELS))
    for k, press in enumerate(presses):
        limits = _quantiles([other for i, other in enumerate(presses) if i != k], levels)
        held[k] = np.searchsorted(press, limits, side="right") / len(press)
    enough = np.flatnonzero(held.mean(axis=0) >= share - 1e-9)
    level = levels[enough[0]] if len(enough) else HIGHEST_LEVEL
    return float(_quantiles(presses, np.array([level]))[0])


def _quantiles(presses: Sequence[np.ndarray], levels: np.ndarray) -> np.ndarray:
    """Quantiles of all pixels, presses of equal weight."""
    values = np.concatenate(presses)
    weights = np.concatenate([np.full(len(press), 1.0 / len(press)) for press in presses])
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / len(presses)
    at = np.searchsorted(share, levels - 1e-9)
    return values[order][np.minimum(at, len(values) - 1)]
