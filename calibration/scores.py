# SPDX-License-Identifier: Apache-2.0
"""What a calibrated block was scored by, from its evidence: figures that a page opens with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from taccel_lab.profile import SensorProfile
from taccel_lab.report.lead import Score

Residuals = Mapping[str, float]
HELD_OUT = "heldout_presses"
"""Residual: how many presses the figures are of."""


def block_scores(key: str, left: Residuals) -> tuple[Score, ...]:
    """Scores of the block ``key`` by its residuals; none where its calibration scored nothing."""
    return tuple(_SCORED[key](left))


def profile_scores(profile: SensorProfile) -> tuple[Score, ...]:
    """Scores of images, then slopes, depths and forces."""
    blocks = profile.blocks()
    return tuple(
        score
        for key in _SCORED
        if key in blocks
        for score in block_scores(key, blocks[key].provenance.residuals)
    )


def _color(left: Residuals) -> Iterator[Score]:
    if "heldout_crop_psnr_db" in left:
        yield Score(
            f"{left['heldout_crop_psnr_db']:.1f}",
            "dB",
            "rendered images against the photos (PSNR)",
            f"{_presses(left)}, in a crop of 1.6 contact radii"
            + _beside(left, "background_crop_psnr_db", "; the untouched image scores {:.1f}"),
        )


def _normals(left: Residuals) -> Iterator[Score]:
    if "heldout_mean_deg" in left:
        yield Score(
            f"{left['heldout_mean_deg']:.2f}",
            "degrees",
            "mean error of surface normals read from photos",
            f"{_presses(left)}, inside the contact"
            + _beside(left, "heldout_flat_deg", "; a flat guess is off by {:.1f}"),
        )
    if "heldout_absolute_depth_mae_mm" in left:
        yield Score(
            f"{left['heldout_absolute_depth_mae_mm']:.3f}",
            "mm",
            "mean error of depths read from photos",
            f"{_presses(left)}, against the ball pressed into the stated pad"
            + _beside(left, "heldout_absolute_depth_mm", ", on average {:.2f} mm deep"),
        )


def _depth(left: Residuals) -> Iterator[Score]:
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


def _material(left: Residuals) -> Iterator[Score]:
    if "indentation_held_out_worst_relative" in left:
        yield Score(
            f"{100 * left['indentation_held_out_worst_relative']:.2g}",
            "% of the force",
            "worst error of forces",
            "each measured point, predicted from the others",
        )


_SCORED: dict[str, Callable[[Residuals], Iterator[Score]]] = {
    "color": _color,
    "normals": _normals,
    "depth_response": _depth,
    "material": _material,
}
"""Blocks by their keys in a profile, in the order of their figures on its page."""


def _presses(left: Residuals) -> str:
    count = left.get(HELD_OUT)
    return "held-out presses" if count is None else f"{count:.0f} held-out presses"


def _beside(left: Residuals, name: str, words: str) -> str:
    return words.format(left[name]) if name in left else ""
