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

from taccel_lab.calibration.capture.sensor_facts import handedness
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.check.light import HANDED
from taccel_lab.calibration.check.picture_figures import LEVELS_KEPT, PictureFigures
from taccel_lab.calibration.remarks import RemarkKind, name_some
from taccel_lab.reading.light import LightDrift
from taccel_lab.reading.thumb import SmallImage
from taccel_lab.reading.whose import not_of
from taccel_lab.report.remark import Remark

COARSE = 0.125
"""The same of 32 levels in all: a slope is then lost in a step."""


MIN_COMPARED = 4
"""Presses from which on one is compared with most."""
MOST_POWER = 1.35
"""Power of the background's levels, or one over it, that a sound frame's have at most. On four sets
that it was chosen on they have 0.79 to 1.06, as contacts hide light; a gamma of 0.5 has 0.5."""
GAIN_SIGMA = 0.03
"""Standard deviation of a channel's gain from which on the background is too even to tell."""
MOST_FINE = 1.7
"""Noise of a sound frame over that of most. On two sets that it was chosen on it has 1.57 at most,
where a sharp edge is pressed; local contrast of a factor of two doubles it."""
MIRRORED = 0.5
"""Part of the usual turn of the lamps, with the other sign, from which on a picture is mirrored,
which all of it would say. Sound ones at the rim of a DIGIT have up to 0.4."""
BY_LAMPS = "mirrored: each colour comes from the other side than in most"


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


def check_tone(frames: Sequence[FrameFigures]) -> list[Remark]:
    """Presses whose levels are no multiple of the light: against their background, or against each
    other where a curve changes with the place. Copied or dead channels are said by themselves."""
    found = []
    sound = [f for f in frames if not any(f.picture.copies) and not f.picture.dead]
    frames = sound or frames
    powers = {frame.press.name: power_of(frame.light) for frame in frames}
    bent = {
        name: power for name, power in powers.items() if abs(np.log(power)) > np.log(MOST_POWER)
    }
    if bent:
        worst = max(bent.values(), key=lambda power: abs(np.log(power)))
        how = f"they go with up to the power of {worst:.2g} of its levels"
        found.append(
            _said(remarks.TONE_CURVE, list(bent), len(frames), than="the background", how=how)
        )
    fine = {frame.press.name: frame.picture.fine_levels for frame in frames}
    known = [amplitude for amplitude in fine.values() if amplitude > 0]
    if len(known) < MIN_COMPARED:
        return found
    usual = float(np.median(known))
    rough = [n for n, one in fine.items() if one > MOST_FINE * usual and n not in bent]
    if rough:
        how = f"noise is up to {max(fine[name] for name in rough) / usual:.1f} times as strong"
        found.append(_said(remarks.TONE_CURVE, rough, len(frames), than="most", how=how))
    return found


def power_of(light: LightDrift) -> float:
    """Power of the background's levels that a frame's ones go with: 1 whatever the brightness of
    each lamp, as black stays black; 1 as well where the background is too even to tell."""
    there = light.gain * light.level
    told = (light.covariance[:, 0, 0] < GAIN_SIGMA**2) & (there > 0) & (there + light.offset > 0)
    if not told.any():
        return 1.0
    return float(np.median((there / np.maximum(there + light.offset, 1e-9))[told]))


def _check_sides(frames: Sequence[FrameFigures]) -> list[Remark]:
    """Presses that fit the background better when they are turned or mirrored, or whose lamps
    stand round the contact the other way than in most."""
    told: dict[str, list[str]] = {}
    turns = {f.press.name: handedness(f.lamps) for f in frames if np.isfinite(f.lamps).all()}
    usual = float(np.median(list(turns.values()))) if len(turns) >= MIN_COMPARED else 0.0
    reversed_lamps = {
        name for name, turn in turns.items() if abs(usual) > HANDED and -turn / usual > MIRRORED
    }
    shape = (frames[0].rest.shape[0], frames[0].rest.shape[1])
    known = SmallImage(frames[0].rest, None, shape)
    for frame in frames:
        if all(frame.picture.copies):  # Without colours the sides of many sensors are alike.
            continue
        why = not_of(known, SmallImage(frame.thumb, None, shape), frame.light) or ""
        if "turned" in why or "mirrored" in why:
            told.setdefault(why.removeprefix("it fits the background "), []).append(
                frame.press.name
            )
        elif frame.press.name in reversed_lamps:
            told.setdefault(BY_LAMPS, []).append(frame.press.name)
    return [
        _said(remarks.SIDES_EXCHANGED, names, len(frames), how=how) for how, names in told.items()
    ]
