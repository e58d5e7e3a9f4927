# SPDX-License-Identifier: Apache-2.0
"""What trials on a robot say: a rate with its interval a policy, and policies compared by start."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.tasks.result import success_interval
from taccel_lab.tasks.robot_trials import TrialFolder


@dataclass(frozen=True)
class Rate:
    """How often a policy succeeded."""

    policy: str
    successes: int
    trials: int
    voids: int
    """Trials that were repeated."""
    rate: float
    interval_95: tuple[float, float]


@dataclass(frozen=True)
class Comparison:
    """Two policies from the same starts."""

    policies: tuple[str, str]
    both: int
    only_first: int
    only_second: int
    neither: int
    difference: float
    """Rate of the first less that of the second."""
    interval_95: tuple[float, float]
    """[Newcombe 1998, Stat. Med. 17:2635, method 10]."""
    p_value: float
    """Exact test of equal rates [McNemar 1947, Psychometrika 12:153], two-sided."""


@dataclass(frozen=True)
class TrialSummary:
    """All that a report of trials states."""

    task: str
    recorded: int
    planned: int
    corrected: int
    rates: tuple[Rate, ...]
    comparisons: tuple[Comparison, ...]

    def table(self) -> dict[str, Any]:
        """The summary as JSON holds it."""
        return {
            **vars(self),
            "rates": [vars(rate) for rate in self.rates],
            "comparisons": [vars(one) for one in self.comparisons],
        }


def summarise(found: TrialFolder, *, interim: bool = False) -> TrialSummary:
    """Rates and comparisons of recorded trials.

    Args:
        found: Of ``read_trials``.
        interim: Before all trials are recorded, too.

    Raises:
        InputError: No trial is recorded, or not all are and ``interim`` is not set.
    """
    judged = {n: t.outcome == "success" for n, t in found.standing().items() if t.outcome != "void"}
    planned = len(found.plan.trials)
    if not judged:
        raise InputError(
            f"{found.root}: no trial is recorded yet; taccel-lab trials next says what to lay out"
        )
    if len(judged) < planned and not interim:
        raise InputError(
            f"{found.root}: {len(judged)} of {planned} trials are recorded; who looks early stops "
            "where it looks best. --interim shows the rates so far"
        )
    names = list(dict.fromkeys(sorted(found.key.policies)))
    outcomes: dict[str, dict[int, bool]] = {name: {} for name in names}
    for trial in found.plan.trials:
        if trial.number in judged:
            outcomes[found.policy(trial.number)][trial.seed] = judged[trial.number]
    voids = [found.policy(t.number) for t in found.trials if t.outcome == "void"]
    lines = [t.number for t in found.trials if t.outcome != "void"]
    return TrialSummary(
        task=found.plan.task,
        recorded=len(judged),
        planned=planned,
        corrected=len(lines) - len(set(lines)),
        rates=tuple(
            _rate(name, list(of_one.values()), voids.count(name))
            for name, of_one in outcomes.items()
            if of_one
        ),
        comparisons=tuple(
            compared
            for one, other in combinations(names, 2)
            if (compared := _compared((one, other), outcomes[one], outcomes[other]))
        ),
    )


def paired_interval(
    both: int, only_first: int, only_second: int, neither: int
) -> tuple[float, float]:
    """The 95 % interval of a difference of paired rates, by Newcombe's method 10."""
    count = both + only_first + only_second + neither
    first, low1, high1 = success_interval(both + only_first, count)
    second, low2, high2 = success_interval(both + only_second, count)
    product = both * neither - only_first * only_second
    margins = (
        (both + only_first)
        * (only_second + neither)
        * (both + only_second)
        * (only_first + neither)
    )
    # Newcombe's correction of the correlation for counts that are few.
    corrected = max(product - count / 2, 0.0) if product > 0 else float(product)
    phi = corrected / math.sqrt(margins) if margins else 0.0

    def reach(one: float, other: float) -> float:
        return math.sqrt(max(one**2 - 2 * phi * one * other + other**2, 0.0))

    difference = first - second
    return (
        difference - reach(first - low1, high2 - second),
        difference + reach(high1 - first, second - low2),
    )


def _rate(name: str, outcomes: Sequence[bool], voids: int) -> Rate:
    rate, low, high = success_interval(sum(outcomes), len(outcomes))
    return Rate(name, sum(outcomes), len(outcomes), voids, rate, (low, high))


def _compared(
    names: tuple[str, str], first: dict[int, bool], second: dict[int, bool]
) -> Comparison | None:
    from scipy.stats import binomtest

    pairs = [(first[seed], second[seed]) for seed in first if seed in second]
    if not pairs:
        return None
    both, only_first, only_second, neither = (
        pairs.count(kind) for kind in ((True, True), (True, False), (False, True), (False, False))
    )
    differing = only_first + only_second
    return Comparison(
        policies=names,
        both=both,
        only_first=only_first,
        only_second=only_second,
        neither=neither,
        difference=(only_first - only_second) / len(pairs),
        interval_95=paired_interval(both, only_first, only_second, neither),
        p_value=float(binomtest(only_first, differing).pvalue) if differing else 1.0,
    )
