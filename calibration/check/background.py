# SPDX-License-Identifier: Apache-2.0
"""Remarks about the background: missing, of another framing, of another light, with a contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.framing import (
    CLEAR_GAIN,
    OTHER_FRAMING_LEVELS,
    best_channel_order,
    misfit_levels,
    thumb,
)
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.pressed_background import (
    MAX_COMPARED,
    find_pressed_background,
)
from taccel_lab.calibration.circles.color_change import WorkingSize
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.report.remark import Remark

MIN_MEDIAN_PRESSES = 7
DARK_LEVELS = 8.0
_MEDIAN = "The median of the presses stands in for it; --background median of import keeps it"


@dataclass(frozen=True)
class BackgroundCheck:
    """Which picture of the untouched gel the other checks compare with."""

    image: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]: the background, or the median of the presses."""
    is_median: bool
    findings: tuple[Remark, ...]


def median_background(presses: Sequence[CapturedPress]) -> np.ndarray:
    """Median of the presses, RGB uint8: untouched where no pixel is pressed in half of them.

    It is that of their pictures at the working size of contacts, as large as theirs.
    """
    from taccel_lab.calibration.capture.importers.background_guess import median_image

    height, width = presses[0].image().shape[:2]
    size = WorkingSize(PixelGrid(width, height, 1.0, 1.0))
    median = median_image([lambda press=press: size.picture(press.image()) for press in presses])
    return size.enlarged(median)


def check_background(folder: CaptureFolder) -> BackgroundCheck:
    """Judge the background against the median of the presses, once a folder.

    Raises:
        InputError: There is none, and too few presses for their median.
    """
    return folder.once.of("background", lambda: _judged(folder))


def _judged(folder: CaptureFolder) -> BackgroundCheck:
    presses = folder.presses
    if folder.background is None:
        if len(presses) < MIN_MEDIAN_PRESSES:
            raise InputError(
                f"{folder.source}: no background and {len(presses)} presses; give an image of the "
                f"untouched sensor, or at least {MIN_MEDIAN_PRESSES} presses for their median"
            )
        return BackgroundCheck(
            median_background(presses), True, (remarks.NO_BACKGROUND(instead=_MEDIAN),)
        )
    image = folder.background.image()
    if len(presses) < 3:
        return BackgroundCheck(image, False, ())
    median_image = median_background(presses)
    small, median = thumb(image), thumb(median_image)
    misfit = misfit_levels(median, small)
    own = float(np.median([misfit_levels(thumb(press.image()), median) for press in presses[:20]]))
    if misfit < OTHER_FRAMING_LEVELS or misfit < CLEAR_GAIN * own:
        picked = presses[:: max(1, len(presses) // MAX_COMPARED)][:MAX_COMPARED]
        pressed = find_pressed_background(image, picked, folder.mask)
        if pressed is not None:
            enough = len(presses) >= MIN_MEDIAN_PRESSES
            return BackgroundCheck(median_image if enough else image, enough, (pressed,))
        return BackgroundCheck(image, False, tuple(_check_untouched(folder)))
    enough = len(presses) >= MIN_MEDIAN_PRESSES
    if _is_dark(folder, image):
        reason = "it is black, lamps off or the wrong file"
        finding = remarks.BACKGROUND_DIFFERS(reason=reason, advice="")
        return BackgroundCheck(median_image if enough else image, enough, (finding,))
    order, swapped, _ = best_channel_order(small, median)
    if order != (0, 1, 2) and swapped * CLEAR_GAIN < misfit:
        # Said by the check of channels, which sees all images against each other.
        return BackgroundCheck(np.ascontiguousarray(image), False, ())
    advice = (
        " The median of the presses is used here, and as the background with capture import "
        "--background median"
        if enough
        else ""
    )
    reason = (
        f"{misfit:.0f} levels apart after exposure and white balance are fitted, the presses "
        f"among themselves {own:.0f}; of another sensor, framing, time or lamp setting"
    )
    finding = remarks.BACKGROUND_DIFFERS(reason=reason, advice=advice)
    chosen = median_image if enough else image
    return BackgroundCheck(chosen, enough, (finding,))


def _is_dark(folder: CaptureFolder, background: np.ndarray) -> bool:
    """Whether a background that is used as a whole is black."""
    return folder.mask is None and bool(background.mean() < DARK_LEVELS)


def _check_untouched(folder: CaptureFolder) -> list[Remark]:
    """Further images of the untouched sensor: how far it has drifted."""
    background = folder.require_background().image()
    if _is_dark(folder, background):
        return [remarks.BACKGROUND_DIFFERS(reason="it is black", advice="")]
    found = []
    for frame in folder.untouched:
        misfit = misfit_levels(thumb(frame.image()), thumb(background))
        if misfit > OTHER_FRAMING_LEVELS:
            found.append(
                remarks.UNTOUCHED_DIFFERS(name=frame.name, misfit=misfit, frames=[frame.name])
            )
    return found
