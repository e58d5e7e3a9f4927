# SPDX-License-Identifier: Apache-2.0
"""Frames of one sensor beside its untouched image: did one come whole, whose is it, in which light.

What belongs to the untouched image is made once, and a frame is looked at on images that are made
small of it, once for all who ask.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from taccel_lab.reading.common_gain import CommonGain, CommonGains
from taccel_lab.reading.dots.dot_mask import DotMask, painted_over
from taccel_lab.reading.light import LightDrift, LightFit
from taccel_lab.reading.thumb import SmallImage
from taccel_lab.reading.whole_frame import BrokenFrame, Seams, lost_rows
from taccel_lab.reading.whose import (
    FINE_PX,
    FINE_SHARE,
    ITS_OWN,
    LEAST_GAIN,
    MOST_GAIN,
    UNEXPLAINED_LEVELS,
    Pattern,
    not_of,
)


class FrameJudge:
    """Holds the untouched image that frames are judged by."""

    def __init__(self, untouched: np.ndarray, mask: np.ndarray | None = None) -> None:
        """A judge of the sensor's frames.

        Args:
            untouched: RGB levels, shape [height_px, width_px, 3].
            mask: Pixels that count, bool, shape [height_px, width_px]; dots do not in any case.
        """
        self.untouched = untouched.astype(np.float32)
        self.mask, self.dots = mask, DotMask.of(self.untouched)
        self.bare = self.untouched
        """The untouched image as it would be without dots, float32."""
        if self.dots is not None:
            self.bare = painted_over(self.untouched, self._counted(self.dots.at_rest))
        self.seams = Seams(self.untouched)
        self.small = SmallImage.of(self.bare, mask)
        self.pattern = Pattern(self.small)

    @cached_property
    def light(self) -> LightFit:
        """Light of frames against the untouched image."""
        return LightFit(self.small)

    @cached_property
    def fine(self) -> Pattern | None:
        """The gel's finest pattern; None where the untouched image shows none."""
        found = Pattern(SmallImage.of(self.bare, self.mask, FINE_PX), FINE_SHARE)
        return found if found.is_clear else None

    @cached_property
    def gains(self) -> CommonGains:
        """Factors of all channels that are no touch."""
        return CommonGains(self.small)

    def frame(self, image: np.ndarray) -> JudgedFrame:
        """A frame of the untouched image's size, RGB levels."""
        levels = image.astype(np.float32)
        if self.dots is None:
            return JudgedFrame(image, levels, self.mask, self)
        counted = self._counted(self.dots.covered(levels))
        levels -= self.untouched
        return JudgedFrame(image, self.bare + painted_over(levels, counted), counted, self)

    def _counted(self, covered: np.ndarray) -> np.ndarray:
        """Pixels that count and that no dot covers, bool, [h, w]."""
        return ~covered if self.mask is None else self.mask & ~covered


@dataclass(frozen=True)
class JudgedFrame:
    """What is known of a frame before anything is read from it; each is found when asked for."""

    image: np.ndarray
    """RGB levels as they came, shape [height_px, width_px, 3]."""
    levels: np.ndarray
    """The same, float32, where dots are as the gel around them."""
    seen: np.ndarray | None
    """Pixels that count and that no dot covers, bool, [height_px, width_px]; None for all."""
    _judge: FrameJudge

    def with_levels(self, levels: np.ndarray) -> JudgedFrame:
        """The same frame with other levels, of its shape."""
        return replace(self, levels=levels.astype(np.float32))

    def without(self, specks: np.ndarray) -> JudgedFrame:
        """The same frame where ``specks``, bool, [height_px, width_px], and what they blur into are
        as the gel around them."""
        free = cv2.dilate(specks.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
        bare = self._judge.bare
        return self.with_levels(bare + painted_over(self.levels - bare, free))

    @cached_property
    def lost(self) -> BrokenFrame | None:
        """Rows or columns that the camera lost."""
        return lost_rows(self.image, self._judge.untouched, self.seen)

    @cached_property
    def torn(self) -> BrokenFrame | None:
        """Rows or columns beyond a seam."""
        return self._judge.seams.torn(self.levels, self.seen)

    @cached_property
    def still(self) -> LightDrift:
        """The frame's light against the untouched image's if nothing touches."""
        return self._judge.light.still(self._small)

    @cached_property
    def pressed(self) -> LightDrift:
        """The same if something is pressed into the gel."""
        return self._judge.light.press(self._small)

    @cached_property
    def common(self) -> CommonGain | None:
        """A factor of all channels that is no touch."""
        return self._judge.gains.of(self._even)

    @cached_property
    def corners(self) -> CommonGain | None:
        """The same of corners that a lens darkens, alone."""
        return self._judge.gains.corners(self._even)

    @property
    def _even(self) -> np.ndarray:
        """Levels of the small image in the untouched image's light."""
        return self.still.within(self._small).removed(self._small.levels)

    def fault(self) -> str:
        """Why it is not what the camera sees of the gel where it was, or nothing."""
        if self.lost is not None:
            return str(self.lost)
        # Dots go with the gel that a press drags along; only what else there is stands still.
        torn, shift = self.torn, self._shift
        if torn is None and shift is None:
            return ""
        # An image of another sensor has seams against the background, too.
        elsewhere = self._of_no_press(self.pressed)
        if elsewhere:
            return elsewhere
        if torn is not None and (shift is None or torn.last - torn.first >= max(map(abs, shift))):
            return str(torn)
        assert shift is not None
        right, down = shift
        return (
            f"shows the untouched gel's pattern {right:+.0f} px to the right and {down:+.0f} px "
            "down of where the background has it: gel or camera has moved. Give an image of the "
            "untouched sensor as it is now (--background)"
        )

    def foreign(self, light: LightDrift) -> str:
        """Why it is not of the untouched image's sensor, in its ``light``, or nothing."""
        why = self._of_no_press(light)
        if why or not self._is_other_gel:
            return why
        return (
            "shows another gel than the background: nothing of the fine pattern (grain, dust) of "
            "the one is in the other, and their light differs all over; give an image of this gel, "
            "untouched (--background)"
        )

    def _of_no_press(self, light: LightDrift) -> str:
        """Why no press on the untouched image's sensor looks so, or nothing."""
        why = not_of(self._judge.small, self._small, light)
        return "" if why is None else f"is no image of the sensor that was calibrated: {why}"

    @cached_property
    def _is_other_gel(self) -> bool:
        """True where the gel's finest pattern is another one, and the light leaves that open."""
        if self.still.noise_levels < UNEXPLAINED_LEVELS or self._judge.fine is None:
            return False
        small = SmallImage.of(self.levels, self._judge.mask, FINE_PX)
        alike = self._judge.fine.agreement(small, self._gain)
        return alike is not None and alike < ITS_OWN

    @cached_property
    def _small(self) -> SmallImage:
        return SmallImage.of(self.levels, self._judge.mask)

    @cached_property
    def _shift(self) -> tuple[float, float] | None:
        return self._judge.pattern.shift(self._small, self._gain)

    @property
    def _gain(self) -> np.ndarray:
        return np.clip(self.still.gain, LEAST_GAIN, MOST_GAIN)
