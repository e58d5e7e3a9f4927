# SPDX-License-Identifier: Apache-2.0
"""How often a fixed policy that sees the design's markers alone pushes a peg into a hole.

The tasks are ``touch-insertion`` and its variants with the pegs of ManiSkill-ViTac 2025: scene,
policy, starts and criterion, with gels of the design.
"""

from __future__ import annotations

from collections.abc import Sequence

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.evidence import Evidence
from taccel_lab.tasks.result import TaskTrial, success_interval


@metric(
    "insertion_success", "%",
    "part of the starts of the task touch-insertion from which a fixed policy that sees the "
    "design's markers gets a peg into its hole", "higher", (), runs_task=True,
)  # fmt: skip
def insertion_success(evidence: Evidence) -> float:
    """Of all seeds of the task."""
    return _percent(evidence.insertion.trials)[0]


@metric(
    "insertion_low", "%", "lower end of the 95 % interval of insertion_success (Wilson)",
    "higher", (), runs_task=True,
)  # fmt: skip
def insertion_low(evidence: Evidence) -> float:
    """What to rank designs by that were tried from few starts."""
    return _percent(evidence.insertion.trials)[1]


@metric(
    "insertion_high", "%", "upper end of the 95 % interval of insertion_success (Wilson)",
    "higher", (), runs_task=True,
)  # fmt: skip
def insertion_high(evidence: Evidence) -> float:
    """Designs whose intervals lie apart differ."""
    return _percent(evidence.insertion.trials)[2]


@metric(
    "insertion_force", "N",
    "largest force of the hole on the peg in the task touch-insertion, median of the starts",
    "lower", (), runs_task=True,
)  # fmt: skip
def insertion_force(evidence: Evidence) -> float:
    """What the policy does not feel it pushes on."""
    return evidence.insertion.table()["figures"]["jam_force_n"]["median"]


@metric(
    "vitac_success", "%", "as insertion_success, of the three pegs of ManiSkill-ViTac 2025",
    "higher", (), runs_task=True,
)  # fmt: skip
def vitac_success(evidence: Evidence) -> float:
    """Of all seeds of the three tasks."""
    return _percent(evidence.vitac)[0]


@metric(
    "vitac_low", "%", "lower end of the 95 % interval of vitac_success (Wilson)",
    "higher", (), runs_task=True,
)  # fmt: skip
def vitac_low(evidence: Evidence) -> float:
    """What to rank designs by."""
    return _percent(evidence.vitac)[1]


@metric(
    "vitac_high", "%", "upper end of the 95 % interval of vitac_success (Wilson)",
    "higher", (), runs_task=True,
)  # fmt: skip
def vitac_high(evidence: Evidence) -> float:
    """Designs whose intervals lie apart differ."""
    return _percent(evidence.vitac)[2]


def _percent(trials: Sequence[TaskTrial]) -> list[float]:
    """Successes, and the ends of their interval."""
    successes = sum(trial.success for trial in trials)
    return [1e2 * share for share in success_interval(successes, len(trials))]
