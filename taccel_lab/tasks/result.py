# SPDX-License-Identifier: Apache-2.0
"""Trials of a task, and the success rate with its interval."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.errors import InputError

CONFIDENCE = 0.95


@dataclass(frozen=True)
class TaskTrial:
    """What came of one seed."""

    seed: int
    success: bool
    cause: str
    """Why it is no success: what of the criterion it misses, or how the solver failed."""
    steps: int
    """Steps that converged."""
    start: dict[str, float]
    """What the seed drew."""
    figures: dict[str, float]
    """What was measured; names end in their units."""
    felt: np.ndarray | None = None
    """What the gels felt at the end, of tasks that judge all seeds together."""
    cell: tuple[str, ...] = ()
    """What it is of, of tasks with several cells: a hand and an object."""


@dataclass(frozen=True)
class TaskResult:
    """Trials of a run, in the order of their seeds."""

    task: str
    trials: list[TaskTrial]
    seconds: float
    """Wall time of the steps."""
    asked: int
    """Seeds that were asked for: more than there are trials where the run was interrupted."""

    @property
    def successes(self) -> int:
        """How many meet the criterion."""
        return sum(trial.success for trial in self.trials)

    def table(self) -> dict[str, Any]:
        """What goes into a result file: rate, interval, spreads of the figures, a row a seed."""
        rate, low, high = success_interval(self.successes, len(self.trials))
        names = list(dict.fromkeys(name for trial in self.trials for name in trial.figures))
        return {
            "task": self.task,
            "successes": self.successes,
            "trials": len(self.trials),
            "asked": self.asked,
            "success_rate": rate,
            "interval_95": [low, high],
            "interval": "Wilson",
            "solver_failures": sum(t.cause.startswith("solver: ") for t in self.trials),
            "seconds": round(self.seconds, 2),
            "figures": {name: self._spread(name) for name in names},
            **({"cells": self.cells()} if any(trial.cell for trial in self.trials) else {}),
            "per_seed": [
                {
                    "seed": trial.seed,
                    "success": trial.success,
                    "cause": trial.cause,
                    "steps": trial.steps,
                    **({"cell": list(trial.cell)} if trial.cell else {}),
                    **trial.start,
                    **trial.figures,
                }
                for trial in self.trials
            ],
        }

    def cells(self) -> list[dict[str, Any]]:
        """Rate, interval and causes of each cell, in the order in which they come."""
        by_cell: dict[tuple[str, ...], list[TaskTrial]] = {}
        for trial in self.trials:
            by_cell.setdefault(trial.cell, []).append(trial)
        found = []
        for cell, trials in by_cell.items():
            successes = sum(trial.success for trial in trials)
            rate, low, high = success_interval(successes, len(trials))
            causes = Counter(trial.cause.partition(":")[0] for trial in trials if trial.cause)
            found.append(
                {
                    "cell": list(cell),
                    "successes": successes,
                    "trials": len(trials),
                    "success_rate": rate,
                    "interval_95": [low, high],
                    "causes": dict(causes),
                }
            )
        return found

    def _spread(self, name: str) -> dict[str, float]:
        values = np.array([t.figures[name] for t in self.trials if name in t.figures])
        values = values[np.isfinite(values)]
        if len(values) == 0:
            return {}
        low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
        return {"median": float(middle), "p05": float(low), "p95": float(high)}


def success_interval(successes: int, trials: int) -> tuple[float, float, float]:
    """Success rate and its 95 % interval [Wilson 1927, JASA 22:209].

    Raises InputError without a trial, or for more successes than trials.
    """
    from scipy.stats import binomtest

    if trials < 1 or not 0 <= successes <= trials:
        raise InputError(f"{successes} successes of {trials} trials make no rate")
    interval = binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return successes / trials, float(interval.low), float(interval.high)
