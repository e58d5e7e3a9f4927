# SPDX-License-Identifier: Apache-2.0
"""Contents of captures for the blocks that read ball presses, in words, and where a scale may come
from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from taccel_lab.calibration.block import Needs
from taccel_lab.printable import counted

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder

NO_BACKGROUND = "an image of the untouched gel"


def scale_sources(folder: CaptureFolder) -> list[str]:
    """Captures of a known length."""
    sources = []
    if any(board.entry.on_gel and board.entry.pitch_mm is not None for board in folder.boards):
        sources.append("board on the gel")
    if folder.edges:
        sources.append(counted(len(folder.edges), "edge"))
    if folder.markers is not None and folder.markers.pitch_x_mm is not None:
        sources.append("marker pitch")
    if any(press.depth_mm is not None for press in folder.presses):
        sources.append("ball presses with travel")
    return sources


def balls_in_words(folder: CaptureFolder) -> str:
    """Count of ball presses and of those with circles; empty without any."""
    presses, labelled = len(folder.presses), sum(p.circle is not None for p in folder.presses)
    if not presses:
        return ""
    return f"{counted(presses, 'ball press', 'ball presses')} ({labelled} with circles)"


def needs_colored_balls(folder: CaptureFolder, grey: bool | None) -> Needs:
    """Ball presses in coloured light, with what tells their size."""
    if grey:
        return Needs("", "coloured lamps: this sensor, or these images, are grey")
    return _needs_balls(folder)


def needs_grey_balls(folder: CaptureFolder, grey: bool | None) -> Needs:
    """Ball presses on a gel that darkens, with what tells their size."""
    if grey is False:
        return Needs("", "a sensor whose grey levels stand for depth, such as a 9DTact")
    return _needs_balls(folder)


def _needs_balls(folder: CaptureFolder) -> Needs:
    balls, missing = balls_in_words(folder), []
    if folder.background is None:
        missing.append(NO_BACKGROUND)
    if not balls:
        missing.append("ball presses")
    if balls and not folder.ball_radii_mm():
        missing.append("the ball's radius")
    if balls and folder.mm_per_px is None:
        sources = scale_sources(folder)
        if sources:
            balls += f"; scale first, by calibrate scale ({sources[0]})"
        else:
            missing.append("the scale")
    return Needs(balls, ", ".join(missing))
