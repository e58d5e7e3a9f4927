# SPDX-License-Identifier: Apache-2.0
"""Lamps: what would spoil the captures while they can still be taken again.

Limits are those of ``taccel-lab capture check``, which judges the folder afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from taccel_lab.calibration.capture.camera.camera import ControlLock
from taccel_lab.calibration.check.frames import SATURATED_LEVEL, texture_seen
from taccel_lab.calibration.check.light import SATURATED_SHARE
from taccel_lab.calibration.check.presses import BLUR_TEXTURE, USEFUL_TEXTURE
from taccel_lab.calibration.frame_light import (
    BALANCE_LEVELS,
    BALANCE_SHARE,
    NOTABLE_LEVELS,
    LightDrift,
)
from taccel_lab.calibration.record.camera_faults import flicker_words

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
    seen, correlation = texture_seen(image, background, np.ones(image.shape[:2], dtype=bool))
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
