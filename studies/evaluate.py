# SPDX-License-Identifier: Apache-2.0
"""Evaluate designs: build and press each one, compute its figures; alike presses are one batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from studies.design_point import DesignPoint, DesignResult
from studies.metrics import METRICS, Metric
from studies.presses import STANDARD_PRESSES, StandardPress

__all__ = [
    "METRICS",
    "STANDARD_PRESSES",
    "DesignPoint",
    "DesignResult",
    "Metric",
    "StandardPress",
    "evaluate_designs",
]

Progress = Callable[[str, int, int], None]
"""Told what is going on, how many of the simulations are done, and how many there are."""


def evaluate_designs(
    designs: Sequence[DesignPoint],
    presses: Sequence[StandardPress],
    metrics: Sequence[Metric],
    *,
    device: str = "cpu",
    progress: Progress | None = None,
    folder: Path | None = None,
) -> list[DesignResult]:
    """Press every design and compute its figures.

    A design that cannot be built, and a press that does not converge, leave figures None with a
    cause; the others go on.

    Args:
        designs: Points of a study, with unique ids.
        presses: Standard presses; those that the metrics need and that are missing leave figures
            None.
        metrics: What to compute.
        device: Warp device of the solver.
        progress: Called after each batch of simulations.
        folder: Where records of presses are kept (one subfolder a design); none when None.
    """
    raise NotImplementedError
