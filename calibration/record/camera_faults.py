# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a camera whatever it looks at: it is black or white, hangs, or flickers."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.capture.camera.camera import Shot
from taccel_lab.calibration.check.light import DARK_LEVELS
from taccel_lab.calibration.frame_light import NOTABLE_LEVELS

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
