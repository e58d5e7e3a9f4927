# SPDX-License-Identifier: Apache-2.0
"""Figures that a profile's page opens with: what its blocks were scored by, from their evidence."""

from __future__ import annotations

from taccel_lab.calibration.block import Residuals
from taccel_lab.calibration.blocks import all_blocks
from taccel_lab.profile import SensorProfile
from taccel_lab.report.lead import Score

HELD_OUT = "heldout_presses"
"""Residual: how many presses the figures are of."""


def profile_scores(profile: SensorProfile) -> tuple[Score, ...]:
    """Scores of images, then slopes, depths and forces."""
    found = profile.blocks()
    return tuple(
        score
        for block in all_blocks()
        if block.scores is not None and block.key in found
        for score in block.scores(found[block.key].provenance.residuals)
    )


def heldout_presses(left: Residuals) -> str:
    """Held-out presses in words, counted where they are."""
    count = left.get(HELD_OUT)
    return "held-out presses" if count is None else f"{count:.0f} held-out presses"


def beside(left: Residuals, name: str, words: str) -> str:
    """What stands beside a figure, where it is known."""
    return words.format(left[name]) if name in left else ""
