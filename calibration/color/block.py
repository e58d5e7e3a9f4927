# SPDX-License-Identifier: Apache-2.0
"""Colours, from slopes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from taccel_lab.calibration.block import Block, BlockWords, Residuals
from taccel_lab.calibration.color.options import ColorOptions
from taccel_lab.calibration.needs import needs_colored_balls
from taccel_lab.calibration.scores import beside, heldout_presses
from taccel_lab.report.lead import Score


@dataclass(frozen=True, kw_only=True)
class ColorWords(BlockWords, ColorOptions):
    """Fit the pixel-to-colour model to captured ball presses and write a profile.

    Every press is simulated to get the gel's surface under it; the model then learns the colour
    of each pixel from position, normal and displacement. Figures are of presses that were chosen
    before any image was read, and are looked at when the model is frozen. Simulations are kept, so
    that a second run takes the fit only.
    """


def color_scores(left: Residuals) -> Iterator[Score]:
    """Score of rendered images."""
    if "heldout_crop_psnr_db" in left:
        yield Score(
            f"{left['heldout_crop_psnr_db']:.1f}",
            "dB",
            "rendered images against the photos (PSNR)",
            f"{heldout_presses(left)}, in a crop of 1.6 contact radii"
            + beside(left, "background_crop_psnr_db", "; the untouched image scores {:.1f}"),
        )


BLOCK = Block(
    name="color",
    home=__name__,
    words=ColorWords,
    needs=needs_colored_balls,
    fitted_by="fit:calibrate_color",
    shown_by="color_page:color_page",
    choices="options:ColorOptions",
    telling=8,
    key="color",
    scores=color_scores,
)
