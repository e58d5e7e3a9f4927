# SPDX-License-Identifier: Apache-2.0
"""Slopes, from colours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from taccel_lab.calibration.block import Block, BlockWords, Residuals
from taccel_lab.calibration.needs import needs_colored_balls
from taccel_lab.calibration.normals.options import NormalOptions
from taccel_lab.calibration.scores import beside, heldout_presses
from taccel_lab.report.lead import Score


@dataclass(frozen=True, kw_only=True)
class NormalWords(BlockWords, NormalOptions):
    """Fit the model from colour to surface normal to captured ball presses and write a profile.

    Inside a contact the ball gives the normal of every pixel; a small ensemble of networks learns
    it from the change of colour around the pixel, with its own uncertainty. Figures are of
    presses that were chosen before any image was read, and are looked at when the model is frozen.
    `taccel-lab depth` then reads height maps from images.
    """


def normal_scores(left: Residuals) -> Iterator[Score]:
    """Scores of normals and of depths."""
    if "heldout_mean_deg" in left:
        yield Score(
            f"{left['heldout_mean_deg']:.2f}",
            "degrees",
            "mean error of surface normals read from photos",
            f"{heldout_presses(left)}, inside the contact"
            + beside(left, "heldout_flat_deg", "; a flat guess is off by {:.1f}"),
        )
    if "heldout_absolute_depth_mae_mm" in left:
        yield Score(
            f"{left['heldout_absolute_depth_mae_mm']:.3f}",
            "mm",
            "mean error of depths read from photos",
            f"{heldout_presses(left)}, against the ball pressed into the stated pad"
            + beside(left, "heldout_absolute_depth_mm", ", on average {:.2f} mm deep"),
        )


BLOCK = Block(
    name="normals",
    home=__name__,
    words=NormalWords,
    needs=needs_colored_balls,
    fitted_by="fit:calibrate_normals",
    shown_by="normals_page:normals_page",
    choices="options:NormalOptions",
    telling=7,
    key="normals",
    scores=normal_scores,
)
