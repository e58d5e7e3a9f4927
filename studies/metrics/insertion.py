# SPDX-License-Identifier: Apache-2.0
"""How often a fixed policy that sees the design's markers alone pushes a peg into a hole.

The task is ``touch-insertion``: its scene, policy, starts and criterion, with gels of the design.
"""

from __future__ import annotations

from taccel_lab.studies.evidence import Evidence
from taccel_lab.studies.metrics.base import metric
from taccel_lab.tasks.result import success_interval


@metric(
    "insertion_success", "%",
    "part of the starts of the task touch-insertion from which a fixed policy that sees the "
    "design's markers gets a peg into its hole", "higher", (), runs_task=True,
)  # fmt: skip
def insertion_success(evidence: Evidence) -> float:
    """Of all seeds of the task."""
    result = evidence.insertion
    return 1e2 * result.successes / len(result.trials)


@metric(
    "insertion_low", "%", "lower end of the 95 % interval of insertion_success (Wilson)",
    "higher", (), runs_task=True,
)  # fmt: skip
def insertion_low(evidence: Evidence) -> float:
    """What to rank designs by that were tried from few starts."""
    result = evidence.insertion
    return 1e2 * success_interval(result.successes, len(result.trials))[1]


@metric(
    "insertion_high", "%", "upper end of the 95 % interval of insertion_success (Wilson)",
    "higher", (), runs_task=True,
)  # fmt: skip
def insertion_high(evidence: Evidence) -> float:
    """Designs whose intervals lie apart differ."""
    result = evidence.insertion
    return 1e2 * success_interval(result.successes, len(result.trials))[2]


@metric(
    "insertion_force", "N",
    "largest force of the hole on the peg in the task touch-insertion, median of the starts",
    "lower", (), runs_task=True,
)  # fmt: skip
def insertion_force(evidence: Evidence) -> float:
    """What the policy does not feel it pushes on."""
    return evidence.insertion.table()["figures"]["jam_force_n"]["median"]
