# SPDX-License-Identifier: Apache-2.0
"""How often findings about presses err on published sets: ``benchmarks/results/check_errors.json``.

The one place in code that holds these rates: findings quote them, docs/captures.md has their table,
and a test compares them with that result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from taccel_lab.report.remark import Remark


@dataclass(frozen=True)
class ErrorRate:
    """Counts of presses."""

    good_named: int
    """Good ones that the finding names."""
    good: int
    found: int
    """Spoiled ones that it names."""
    spoiled: int
    how: str
    """What was done to these."""
    of: str = "presses"
    """What the good ones are."""

    def sentence(self) -> str:
        """For a finding."""
        return (
            f"On published sets this names {self.good_named} of {self.good} good {self.of}, and "
            f"{self.found} of {self.spoiled} {self.how}."
        )


RATES: dict[str, ErrorRate] = {
    "no_contact": ErrorRate(0, 266, 47, 47, "that show the background"),
    "labels_off": ErrorRate(
        0, 107, 37, 40, "whose label is moved by half a radius or 1.5 times as wide"
    ),
    "blurred": ErrorRate(0, 266, 34, 47, "that are blurred by 0.15 contact radii"),
    "other_ball": ErrorRate(0, 266, 41, 94, "of a ball of 0.6 or 1.6 times the radius"),
    "mixed_sensors": ErrorRate(0, 266, 45, 47, "of another sensor"),
    "channels_swapped": ErrorRate(0, 266, 47, 47, "whose red and blue are swapped"),
    "ball_too_small": ErrorRate(0, 225, 5, 5, "sets whose ball is stated half as large"),
    "ball_too_deep": ErrorRate(
        0, 128, 93, 125, "on a gel that is stated 0.7 times as thick as the median contact is deep"
    ),
    "near_duplicates": ErrorRate(
        0, 266, 45, 47, "that show another press once more, with noise of its own"
    ),
    "saturated": ErrorRate(0, 217, 38, 38, "that are made twice as bright"),
    "wrong_ball_radius": ErrorRate(
        0, 5, 8, 10, "sets whose ball is stated 0.5 or 0.7 times as large", "sets"
    ),
}


def quoted(finding: Remark) -> Remark:
    """The finding with its error rates, where they were measured."""
    rate = RATES.get(finding.code)
    if rate is None:
        return finding
    end = "" if finding.message.endswith(".") else "."
    return replace(finding, message=f"{finding.message}{end} {rate.sentence()}")
