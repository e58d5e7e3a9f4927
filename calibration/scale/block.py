# SPDX-License-Identifier: Apache-2.0
"""The scale, by captures of known length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from taccel_lab.calibration.block import Block, BlockWords, Needs
from taccel_lab.calibration.needs import scale_sources

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder


@dataclass(frozen=True, kw_only=True)
class ScaleWords(BlockWords):
    """Measure mm/px along x and y from captures of known length.

    Boards on the gel, presses of a straight edge, markers of known pitch, and ball presses with
    depths each give a scale with its uncertainty. They are compared and, if they agree, averaged.
    Ball presses without depths give an upper limit only (docs/calibration_camera.md).
    """


def _needs(folder: CaptureFolder, _: bool | None) -> Needs:
    sources = scale_sources(folder)
    if sources:
        return Needs(", ".join(sources))
    stated = ""
    if folder.mm_per_px is not None:
        stated = f" (stated: {folder.mm_per_px[0]:g} x {folder.mm_per_px[1]:g} mm/px)"
    return Needs("", f"a board pressed on, a known edge, balls with travel or marker pitch{stated}")


BLOCK = Block(
    name="scale",
    home=__name__,
    words=ScaleWords,
    needs=_needs,
    checked_by="check:check_known_lengths",
    fitted_by="fit:calibrate_scale",
    shown_by="scale_page:scale_page",
    reads_folder=True,
    measures_scale=True,
    telling=1,
)
