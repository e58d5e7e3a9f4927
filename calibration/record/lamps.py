# SPDX-License-Identifier: Apache-2.0
"""Lamps: what would spoil the captures while they can still be taken again.

That is what is wrong with a camera whatever it looks at (black, white, hanging, flickering), and
what ``taccel-lab capture check`` judges of the folder afterwards, with its limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from taccel_lab.calibration.capture.camera.camera import ControlLock, Shot
from taccel_lab.calibration.check.background import DARK_LEVELS
from taccel_lab.calibration.check.frames import SATURATED_LEVEL, grain, texture_seen
from taccel_lab.calibration.check.light import SATURATED_SHARE
from taccel_lab.calibration.check.presses import BLUR_TEXTURE, USEFUL_TEXTURE
from taccel_lab.calibration.light_drift import BALANCE_LEVELS, BALANCE_SHARE, NOTABLE_LEVELS
from taccel_lab.reading.light import LightDrift

PLAIN_LEVELS = 8.0
"""Range of colours over a small image below which a black or white one shows no gel: untouched gels
of eleven real sensors have 23 (9DTact) to 210 (DIGIT), a covered lens 1 to 2."""
WHITE_LEVELS = 250.0
"""Mean from which an image is white."""
FROZEN_S = 3.0
"""One and the same frame for so long: of a gel that stands still they differ by noise."""
_SPARSE = np.s_[::16, ::16]


def nothing_seen(small: np.ndarray) -> str:
    """Why a small image, levels [h, w, 3], cannot show a gel; empty where it can."""
    low, high = np.percentile(small.reshape(-1, 3), (1, 99), axis=0)
    if float((high - low).max()) >= PLAIN_LEVELS:
        return ""
    level = float(small.mean())
    if level < DARK_LEVELS:
        return f"The image is black ({level:.0f} of 255 levels): uncover the lens, light the lamps."
    if level > WHITE_LEVELS:
        return f"The image is white ({level:.0f} of 255 levels): turn the exposure down."
    return ""


class FrozenWatch:
    """Notices a camera that hangs, and gives one frame for ever; of a replay that is no fault."""

    def __init__(self) -> None:
        self.replayed = False
        self._last: Shot | None = None
        self._since_s = 0.0

    def see(self, shot: Shot) -> str:
        """Take the next frame in; what to do where the camera hangs, else empty."""
        last, self._last = self._last, shot
        if last is None or not 0 <= shot.time_s - self._since_s or not _same(last, shot):
            self._since_s = shot.time_s
            return ""
        seconds = shot.time_s - self._since_s
        if self.replayed or seconds < FROZEN_S:
            return ""
        return (
            f"The camera hangs: one and the same image for {FROZEN_S:.0f} s and more. Unplug it "
            "and plug it in again."
        )


def flicker_words(levels: float) -> str:
    """What to do about light that goes up and down by ``levels``; empty where it hardly does."""
    if levels <= NOTABLE_LEVELS:
        return ""
    return (
        f"the light flickers by {levels:.0f} levels up and down from frame to frame: shut room "
        "light out, or set the exposure to a multiple of 10 ms (mains of 50 Hz) or 8.3 ms (60 Hz)"
    )


def _same(one: Shot, other: Shot) -> bool:
    if one.image.shape != other.image.shape:
        return False
    few = np.array_equal(one.image[_SPARSE], other.image[_SPARSE])
    return few and np.array_equal(one.image, other.image)


State = Literal["ok", "warn", "bad", "unknown"]
TOUCHED_SHARE = 0.25
"""Part of the largest change from which a pixel counts as touched."""


@dataclass(frozen=True)
class Lamp:
    """One thing that is watched."""

    name: str
    state: State
    text: str
    """One sentence."""


def saturation_lamp(image: np.ndarray, touched: np.ndarray | None) -> Lamp:
    """Pixels that are as bright as the camera can tell, of the contact or of the whole image.

    ``image`` is RGB uint8 [h, w, 3], ``touched`` a small mask of the contact.
    """
    full = (image.max(axis=-1) >= SATURATED_LEVEL).astype(np.float32)
    where = "image"
    share = float(full.mean())
    if touched is not None and touched.any():
        small = cv2.resize(full, touched.shape[::-1], interpolation=cv2.INTER_AREA)
        share, where = float(small[touched].mean()), "contact"
    if share > SATURATED_SHARE:
        return Lamp(
            "saturation",
            "bad",
            f"{share:.0%} of the {where} is at full brightness, where colours are lost: turn the "
            "exposure down and begin again",
        )
    if share > 0.2 * SATURATED_SHARE:
        return Lamp("saturation", "warn", f"{share:.1%} of the {where} is at full brightness")
    return Lamp("saturation", "ok", f"{share:.1%} of the {where} is at full brightness")


def blur_lamp(image: np.ndarray, background: np.ndarray) -> Lamp:
    """Whether the untouched gel's fine texture shows as it does in the background, both RGB
    [h, w, 3]."""
    everywhere = np.ones(image.shape[:2], dtype=bool)
    seen, correlation = texture_seen(grain(image), grain(background), everywhere)
    if not np.isfinite(seen) or (correlation < USEFUL_TEXTURE and seen > BLUR_TEXTURE):
        return Lamp("blur", "unknown", "this gel shows no texture by which blur could be seen")
    if seen < BLUR_TEXTURE:
        return Lamp(
            "blur",
            "bad",
            f"{max(seen, 0):.0%} of the gel's texture shows: the image is blurred or has shifted "
            "since the background was taken. Is the focus locked, does anything move?",
        )
    return Lamp("blur", "ok", f"{min(seen, 1):.0%} of the gel's texture shows")


def drift_lamp(light: LightDrift, background: np.ndarray) -> Lamp:
    """How far the light has moved from the background's (RGB levels, [h, w, 3])."""
    shift = light.shift(background.reshape(-1, 3).astype(np.float64).mean(axis=0))
    apart = float(np.abs(shift - shift.mean()).max())
    worst = float(np.abs(shift).max())
    text = "red {:+.1f}, green {:+.1f}, blue {:+.1f} levels since the background".format(
        *(np.round(shift, 1) + 0.0)  # No -0.0.
    )
    if apart > BALANCE_LEVELS and apart > BALANCE_SHARE * worst:
        return Lamp(
            "drift", "bad", f"{text}: the channels part. Switch the automatic white balance off"
        )
    if worst > 2 * NOTABLE_LEVELS:
        return Lamp(
            "drift",
            "bad",
            f"{text}: the light has changed. Lock the exposure, let the lamps warm up, begin again",
        )
    state: State = "warn" if worst > NOTABLE_LEVELS else "ok"
    return Lamp("drift", state, text)


def flicker_lamp(levels: float) -> Lamp:
    """Whether the light stood still while the untouched gel was measured."""
    text = flicker_words(levels)
    if not text:
        return Lamp("flicker", "ok", f"the light goes up and down by {levels:.1f} levels")
    return Lamp("flicker", "bad" if levels > 2 * NOTABLE_LEVELS else "warn", text)


def controls_lamp(locks: tuple[ControlLock, ...], replayed: bool, hangs: str = "") -> Lamp:
    """Whether the camera goes on, and holds its settings."""
    if hangs:
        return Lamp("camera", "bad", hangs)
    if replayed:
        return Lamp("camera", "unknown", "a replay: nothing can be locked")
    failed = [str(lock) for lock in locks if lock.held is False]
    if failed:
        return Lamp("camera", "bad", "; ".join(failed) + ". The drift lamp shows the effect")
    missing = [lock.name for lock in locks if lock.held is None]
    text = ", ".join(str(lock) for lock in locks if lock.held)
    if missing:
        return Lamp("camera", "warn", f"{text}; no control of {', '.join(missing)} to lock")
    return Lamp("camera", "ok", text)


def touched_pixels(change: np.ndarray, noise_levels: float) -> np.ndarray:
    """Pixels of the small image in a contact, bool [h, w], by the smoothed change [h, w, 3]."""
    size = np.sqrt(np.square(change).sum(axis=-1))
    return size > max(TOUCHED_SHARE * float(size.max()), noise_levels)
