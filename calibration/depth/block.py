# SPDX-License-Identifier: Apache-2.0
"""Depths, from how far a grey gel darkens."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from taccel_lab.calibration.block import Block, BlockWords, Residuals
from taccel_lab.calibration.depth.options import DepthOptions
from taccel_lab.calibration.needs import needs_grey_balls
from taccel_lab.report.lead import Score


@dataclass(frozen=True, kw_only=True)
class DepthWords(BlockWords, DepthOptions):
    """Fit the depth of a grey sensor (9DTact) to ball presses and write a profile.

    Such a gel looks darker where it is pressed. The ball's shape gives the depth of every pixel
    inside a contact. A monotone curve from grey level to depth is fitted, with its error on
    left-out presses, or parts of a single one. Where the captures state no scale, the base's camera
    gives it. Rectify raw images of a distorting lens with --maps. `taccel-lab depth` then reads
    height maps.
    """


def depth_scores(left: Residuals) -> Iterator[Score]:
    """Scores of depths and of shapes."""
    if "absolute_depth_mm" in left:
        yield Score(
            f"{left['absolute_depth_mm']:.2f}",
            "mm",
            "expected error of depths read from photos",
            "pixels left out of the fit, and where depths are counted from",
        )
    if "left_out_depth_mm" in left:
        yield Score(
            f"{left['left_out_depth_mm']:.3f}",
            "mm",
            "mean error of the shape in one photo",
            "pixels left out of the fit, against the ball: one offset of all depths aside",
        )


BLOCK = Block(
    name="depth",
    home=__name__,
    words=DepthWords,
    needs=needs_grey_balls,
    fitted_by="fit:calibrate_depth",
    shown_by="depth_page:depth_page",
    choices="options:DepthOptions",
    telling=6,
    key="depth_response",
    scores=depth_scores,
)
