# SPDX-License-Identifier: Apache-2.0
"""What a metric is, and what it is computed from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from taccel_lab.errors import InputError
from taccel_lab.studies.design_point import NoFigure

if TYPE_CHECKING:
    from taccel_lab.studies.evidence import Evidence

__all__ = ["METRICS", "Better", "Metric", "NoFigure", "metric"]

Better = Literal["higher", "lower", "none"]


@dataclass(frozen=True)
class Metric:
    """A figure of merit of a design."""

    name: str
    unit: str
    description: str
    better: Better
    """Which way is better, when a designer has no other wish."""
    presses: tuple[str, ...]
    """Names of the standard presses it is read from; () for what needs none."""
    compute: Callable[[Evidence], float]
    """The value in ``unit``; raises NoFigure."""


METRICS: dict[str, Metric] = {}
"""All metrics by name; ``taccel_lab.studies.metrics`` fills it in."""


def metric(
    name: str, unit: str, description: str, better: Better, presses: tuple[str, ...]
) -> Callable[[Callable[[Evidence], float]], Callable[[Evidence], float]]:
    """Register the decorated function as a metric."""

    def register(compute: Callable[[Evidence], float]) -> Callable[[Evidence], float]:
        if name in METRICS:
            raise InputError(f"there are two metrics called {name!r}")
        METRICS[name] = Metric(name, unit, description, better, presses, compute)
        return compute

    return register
