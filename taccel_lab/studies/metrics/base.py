# SPDX-License-Identifier: Apache-2.0
"""Metrics, the figures of merit of a design."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeVar

from taccel_lab.errors import InputError
from taccel_lab.studies.metrics.design_point import LOAD_N, Fitted

if TYPE_CHECKING:
    from taccel_lab.studies.metrics.evidence import Evidence


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
    compute: Callable[[Evidence], float | Fitted]
    """The value in ``unit``; raises NoFigure."""
    also: tuple[str, ...] = ()
    """Presses that it can be read from as well, where a study has them."""
    at_load: bool = False
    """Whether it is read at a load."""
    each_tool: bool = True
    """Whether every indenter of a press has its own value."""
    indenter: str = ""
    """The one that it is read of; empty for the press's first."""
    load_n: float = LOAD_N
    """Load at which it is read, where it is read at a load."""
    runs_task: bool = False
    """Whether a whole task is simulated for it, which takes longer than all presses."""
    smooth: bool = False
    """Whether it has derivatives by dimensions and moduli, so that optimisers may follow them."""

    @property
    def base(self) -> str:
        """Name without indenter and load."""
        return self.name.partition("[")[0]

    def read(self, evidence: Evidence) -> Fitted:
        """The value of a design, fitted or not; raises NoFigure."""
        if self.presses:
            evidence = evidence.of(self.presses[0], self.indenter, self.load_n)
        found = self.compute(evidence)
        return found if isinstance(found, Fitted) else Fitted(float(found), 0.0)


METRICS: dict[str, Metric] = {}
"""All metrics by name; ``taccel_lab.studies.metrics`` fills it in."""


_Compute = TypeVar("_Compute", bound=Callable[..., "float | Fitted"])


def metric(
    name: str,
    unit: str,
    description: str,
    better: Better,
    presses: tuple[str, ...],
    *,
    also: tuple[str, ...] = (),
    each_tool: bool = True,
    runs_task: bool = False,
    smooth: bool = False,
) -> Callable[[_Compute], _Compute]:
    """Register the decorated function as a metric.

    In ``description``, ``{tool}`` stands for the indenter; with ``{load}`` in it, the metric is
    read at a load.
    """

    def register(compute: _Compute) -> _Compute:
        if name in METRICS:
            raise InputError(f"there are two metrics called {name!r}")
        at_load = "{load}" in description
        METRICS[name] = Metric(
            name, unit, description, better, presses, compute, also, at_load, each_tool,
            runs_task=runs_task, smooth=smooth,
        )  # fmt: skip
        return compute

    return register
