# SPDX-License-Identifier: Apache-2.0
"""Findings about pictures as files: channels that are dead or copies, levels that are missing,
detail that is missing, sides that are exchanged.

Limits are by what no camera does: noise alone gives every level between two others to thousands of
pixels, differs between channels, and reaches down to single pixels. Of 20 sensors whose pictures
are public, the worst has 99 % of its levels, channels that differ in 81 % of the pixels, and detail
of 0.44 levels at four pixels; thumbnails that were enlarged four times keep 0.33 at most.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.check.picture_figures import LEVELS_KEPT, PictureFigures
from taccel_lab.calibration.remarks import RemarkKind, name_some
from taccel_lab.reading.thumb import SmallImage
from taccel_lab.reading.whose import not_of
from taccel_lab.report.remark import Remark

COARSE = 0.125
"""The same of 32 levels in all: a slope is then lost in a step."""


def check_pictures(frames: Sequence[FrameFigures], background: np.ndarray) -> list[Remark]:
    """All findings of this module on presses and their background, RGB levels, uint8."""
    if not frames:
        return []
    own = PictureFigures.of(background, frames[0].rest)
    pictures = [("the background", own), *((f.press.name, f.picture) for f in frames)]
    found = []
    dead = {name: figures.dead for name, figures in pictures if figures.dead}
    if dead:
        channels = sorted({channel for one in dead.values() for channel in one})
        what = f"{', '.join(channels)} {'is' if len(channels) == 1 else 'are'} dead"
        found.append(_said(remarks.CHANNEL_DEAD, list(dead), len(pictures), what=what))
    copied = [name for name, figures in pictures if any(figures.copies) and name not in dead]
    all_grey = all(all(figures.copies) for _, figures in pictures)
    if copied and not all_grey:
        found.append(_said(remarks.CHANNELS_EQUAL, copied, len(pictures)))
    kept = {name: f.levels_kept for name, f in pictures if f.levels_kept < LEVELS_KEPT}
    if kept:
        least = min(kept.values())
        found.append(_said(remarks.LEVELS_MISSING, list(kept), len(pictures), least=least,
                           grave=least < COARSE and 2 * len(kept) > len(pictures)))  # fmt: skip
    enlarged = [name for name, figures in pictures if figures.is_enlarged]
    if enlarged:
        found.append(_said(remarks.ENLARGED, enlarged, len(pictures)))
    return [*found, *_check_sides(frames)]


def _said(kind: RemarkKind, names: list[str], count: int, **figures: object) -> Remark:
    figures = {"grave": 2 * len(names) > count, **figures}
    return kind(bad=len(names), count=count, names=name_some(names), frames=names, **figures)  # type: ignore[arg-type]


def _check_sides(frames: Sequence[FrameFigures]) -> list[Remark]:
    """Presses that fit the background better when they are turned or mirrored."""
    told: dict[str, list[str]] = {}
    for frame in frames:
        shape = (frame.thumb.shape[0], frame.thumb.shape[1])
        known, seen = (SmallImage(levels, None, shape) for levels in (frame.rest, frame.thumb))
        why = not_of(known, seen, frame.light) or ""
        if "turned" in why or "mirrored" in why:
            told.setdefault(why.removeprefix("it fits the background "), []).append(
                frame.press.name
            )
    return [
        _said(remarks.SIDES_EXCHANGED, names, len(frames), how=how) for how, names in told.items()
    ]
