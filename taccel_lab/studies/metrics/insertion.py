# SPDX-License-Identifier: Apache-2.0
"""How often a fixed policy that sees the design's markers alone pushes a peg into a hole.

The tasks are ``touch-insertion`` and its variants with the pegs of ManiSkill-ViTac 2025: scene,
policy, starts and criterion, with gels of the design.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.evidence import Evidence
from taccel_lab.tasks.result import TaskTrial, success_interval


def _successes(
    name: str, description: str, trials: Callable[[Evidence], Sequence[TaskTrial]]
) -> None:
    """Register ``NAME_success`` over all seeds, and both ends of its interval: designs whose
    intervals lie apart differ, and the low end ranks those that were tried from few starts."""

    def share(end: int) -> Callable[[Evidence], float]:
        def compute(evidence: Evidence) -> float:
            found = trials(evidence)
            return 1e2 * success_interval(sum(trial.success for trial in found), len(found))[end]

        return compute

    interval = f"end of the 95 % interval of {name}_success (Wilson)"
    for end, (word, meaning) in enumerate(
        (("success", description), ("low", f"lower {interval}"), ("high", f"upper {interval}"))
    ):
        metric(f"{name}_{word}", "%", meaning, "higher", (), runs_task=True)(share(end))


_successes(
    "insertion",
    "part of the starts of the task touch-insertion from which a fixed policy that sees the "
    "design's markers gets a peg into its hole",
    lambda evidence: evidence.insertion.trials,
)


@metric(
    "insertion_force", "N",
    "largest force of the hole on the peg in the task touch-insertion, median of the starts",
    "lower", (), runs_task=True,
)  # fmt: skip
def insertion_force(evidence: Evidence) -> float:
    """What the policy does not feel it pushes on."""
    return evidence.insertion.table()["figures"]["jam_force_n"]["median"]


_successes(
    "vitac",
    "as insertion_success, of the three pegs of ManiSkill-ViTac 2025",
    lambda evidence: evidence.vitac,
)
