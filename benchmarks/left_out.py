# SPDX-License-Identifier: Apache-2.0
"""Values of a setting chosen on all sets but one, and whether they beat the default by more than
noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

Scores = Mapping[str, Mapping[str, np.ndarray]]
"""Figures by value of the setting and by set, more is better, shape [seed, press]."""
SURE_DEVIATIONS = 2.0
"""A gain counts when it is this many standard errors."""


@dataclass(frozen=True)
class Choice:
    """What the other sets choose for one."""

    left_out: str
    value: str
    gain: float
    """Mean over the other sets of the value's figure less the default's."""
    noise: float
    """Standard error of the gain: scatter of presses, and of seeds."""


def choose_left_out(
    scores: Scores, default: str, seed_deviation: Mapping[str, float] | None = None
) -> list[Choice]:
    """For every set the value with the best mean over the others; the default where it is as good.

    Gains are paired: the same press, the same seed. Where there is one seed alone,
    ``seed_deviation`` says how far another moves the mean of each set.
    """
    moved = seed_deviation or {}
    found = []
    for left_out in scores[default]:
        others = [name for name in scores[default] if name != left_out]
        gains = {
            value: _gain(by_set, scores[default], others, moved) for value, by_set in scores.items()
        }
        best = max(gains, key=lambda value: (gains[value][0], value == default))
        found.append(Choice(left_out, best, *gains[best]))
    return found


def beats_default(choices: list[Choice], default: str) -> bool:
    """Whether one other value is chosen whichever set is left out, each time beyond noise."""
    same = len({choice.value for choice in choices}) == 1 and choices[0].value != default
    return same and all(choice.gain > SURE_DEVIATIONS * choice.noise for choice in choices)


def _gain(
    by_set: Mapping[str, np.ndarray],
    reference: Mapping[str, np.ndarray],
    sets: list[str],
    moved: Mapping[str, float],
) -> tuple[float, float]:
    """Mean over sets of the paired gain, and its standard error."""
    means, variances = [], []
    for name in sets:
        gain = np.asarray(by_set[name]) - np.asarray(reference[name])
        seeds, presses = gain.shape
        means.append(gain.mean())
        variance = gain.mean(axis=0).var(ddof=1) / presses
        if seeds > 1:
            variance += gain.mean(axis=1).var(ddof=1) / seeds
        else:
            variance += 2 * moved.get(name, 0.0) ** 2
        variances.append(variance)
    return float(np.mean(means)), float(np.sqrt(np.sum(variances)) / len(sets))
