# SPDX-License-Identifier: Apache-2.0
"""How often a fixed policy that sees the design's markers alone pushes a peg into a hole.

The tasks are ``touch-insertion`` and its variants with the pegs of ManiSkill-ViTac 2025: scene,
policy, starts and criterion, with gels of the design.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.evidence import Evidence
from taccel_lab.tasks.result import TaskTrial, success_interval


def _percent(
    trials: Callable[[Evidence], Sequence[TaskTrial]], place: int, evidence: Evidence
) -> float:
    """Part of the seeds that succeed, or an end of its interval: designs whose intervals lie apart
    differ, and the low end ranks those that were tried from few starts."""
    found = trials(evidence)
    return 1e2 * success_interval(sum(trial.success for trial in found), len(found))[place]


for _name, _trials_of, _meaning in (
    (
        "insertion",
        attrgetter("insertion.trials"),
        "part of the starts of the task touch-insertion from which a fixed policy that sees the "
        "design's markers gets a peg into its hole",
    ),
    (
        "vitac",
        attrgetter("vitac"),
        "as insertion_success, of the three pegs of ManiSkill-ViTac 2025",
    ),
):
    _interval = f"end of the 95 % interval of {_name}_success (Wilson)"
    for _place, (_word, _text) in enumerate(
        (("success", _meaning), ("low", f"lower {_interval}"), ("high", f"upper {_interval}"))
    ):
        # Other processes find this module's function and an attrgetter, not a lambda of ours.
        metric(f"{_name}_{_word}", "%", _text, "higher", (), runs_task=True)(
            partial(_percent, _trials_of, _place)
        )


@metric(
    "insertion_force", "N",
    "largest force of the hole on the peg in the task touch-insertion, median of the starts",
    "lower", (), runs_task=True,
)  # fmt: skip
def insertion_force(evidence: Evidence) -> float:
    """What the policy does not feel it pushes on."""
    return evidence.insertion.table()["figures"]["jam_force_n"]["median"]
