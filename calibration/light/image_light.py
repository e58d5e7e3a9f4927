# SPDX-License-Identifier: Apache-2.0
"""The light of one image against the untouched sensor: what is taken off it, or why it is not read.

A press leaves a part of the image as it was, but for the light of each channel: gain, offset and,
where the calibration saw lamps age unevenly, a field over the image. What explains that part is
light; what it leaves is the touch. A touch that fills the image looks like light, so that light has
to be shown: nothing is taken off where the fit explains less than half of the pixels, which is
where estimators break down that are told neither part; nor where a share of them still shows the
background as it is, which no change of the light leaves alone.

Where not even a quarter of the pixels fits, or the light is beyond what 8 bits can be brought back
from, or the image fits the background better with its channels or sides exchanged, whatever is
read from it means nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.calibration.light.fit import CLIPPED_LEVELS, LightFit
from taccel_lab.calibration.light.light import Light

SAMPLE_COUNT = 3000
"""Pixels that are looked at: smoothed over two, neighbours on a finer lattice tell no more."""
TOLD, QUARTER = 0.5, 0.25
"""Shares of the pixels that a light has to explain, and that an image of the sensor shows."""
MOST_LEVELS = 12.0
"""Most that these pixels may be off by, once the light is alike [levels]. Twice the largest of 72
presses of a GelSight Mini and a DIGIT (FOTS), 6.0; presses of two sensors that it was not chosen on
have 3.0 (RVSATHU) and 1.2 (9DTact) at most, backgrounds of other sensors 15 to 200."""
LEAST_LIGHT, MOST_LIGHT = 0.4, 2.5
"""Light of a channel, as a share of the background's, that is taken off: at the least, noise of
the camera and of its 8 bits counts 2.5 times."""
LEAST_GAIN, MOST_GAIN = 0.25, 4.0
"""The same of the gain alone, which is told by shades of the background only; presses have 0.8 to
1.5."""
CLIPPED, MOST_CLIPPED = 0.01, 0.25
"""Shares of the pixels that the light has brought to the end of the camera's range, from which on a
reading is warned of, and refused: nothing brings their level back. Presses that saturate by
themselves have 19 % at most (FOTS, 31)."""
LASTING, LASTING_PART = 0.05, 0.25
"""Share of the pixels from which on the light has not changed, if they show the background as it
is: to this part of what the fitted light would have changed them by, and that is above noise."""
FIELD_SIGMAS = 3.0
"""A field is taken off up to so many of the standard deviations that the calibration saw."""
HALVED = 0.5
"""Part of what gain and offset leave that a field beyond these leaves, where it is no chance: three
quarters of the variance are its own. Presses have 0.56 to 1.1, under fields of 10 % 0.2 to 0.7."""
CLEARLY = 3.0
"""An image whose channels or sides are exchanged fits the background better by this factor."""
_LEAST_LEVELS = 3.0
"""Differences below this are noise."""
STILL = Light(np.ones(3), np.zeros(3))
CHANNELS = ("red", "green", "blue")

_EXCHANGED: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "with red and blue exchanged (BGR for RGB?)": lambda image: image[..., ::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
}


@dataclass(frozen=True)
class ImageLight:
    """What is known of one image's light."""

    light: Light
    """Of the image against the background, to be removed; none (``STILL``) where none is told."""
    told: bool
    """Whether enough of the image is at rest to tell it."""
    level: np.ndarray
    """Mean of the background by channel [levels], shape [3]."""
    field_left_levels: float = 0.0
    """Largest change, from the middle to a side, of a field that was left in since the calibration
    saw none as large [levels]; 0 where there is none."""
    clipped: float = 0.0
    """Share of the pixels that the light has brought to the end of the camera's range."""
    refused: str = ""
    """Why the image is none of the sensor's, or cannot be read; empty where it can."""

    @property
    def brightness(self) -> np.ndarray:
        """Light of each channel at the background's mean level, as a share of it, shape [3]."""
        return 1.0 + self.light.shift(self.level) / np.maximum(self.level, 1.0)

    def figures(self) -> dict[str, Any]:
        """Ready for JSON; channels are red, green, blue."""
        return {
            "told": self.told,
            "brightness": self.brightness.tolist(),
            "gain": self.light.gain.tolist(),
            "offset_levels": self.light.offset.tolist(),
            "gradient_levels": self.light.gradient.tolist(),
            "field_left_levels": self.field_left_levels,
            "clipped_share": self.clipped,
        }


class LightReader:
    """Tells the light of images of one sensor; what does not depend on the image is done once."""

    def __init__(
        self,
        background: np.ndarray,
        mask: np.ndarray | None = None,
        field_sigma_levels: np.ndarray | None = None,
    ) -> None:
        """
        Args:
            background: Untouched sensor, RGB levels, float, shape [height_px, width_px, 3].
            mask: Pixels that count, bool, shape [height_px, width_px].
            field_sigma_levels: Standard deviation of the light's gradient by channel, from the
                middle to a side, that the calibration saw [levels], shape [3]; None: no field.

        Raises:
            InputError: The mask leaves too few pixels.
        """
        self._fit = LightFit(background, mask, SAMPLE_COUNT)
        self._level = self._fit.before[self._fit.counts].mean(axis=0)
        seen = np.zeros(3) if field_sigma_levels is None else np.asarray(field_sigma_levels)
        self._field = FIELD_SIGMAS * seen

    def read(self, image: np.ndarray) -> ImageLight:
        """The light of one image, RGB levels, float, of the background's shape."""
        seen = self._fit.sampled(image)
        light, field = self._told(seen)
        told = light is not None
        found = ImageLight(light or STILL, told, self._level, field if told else 0.0)
        # What is clipped in the background's light as well is as it was when it was calibrated.
        lost = (seen > CLIPPED_LEVELS) & (
            self._fit.removed(seen, found.light) < CLIPPED_LEVELS - MOST_LEVELS
        )
        found = replace(found, clipped=float(np.any(lost, axis=-1)[self._fit.counts].mean()))
        return replace(found, refused=self._refusal(seen, found))

    def _told(self, seen: np.ndarray) -> tuple[Light | None, float]:
        """The light to take off, None where it cannot be told, and the field left in [levels]."""
        light, uneven = (self._fit.fit(seen, gradient=field) for field in (False, True))
        left, most = 0.0, np.abs(uneven.gradient).max(axis=1)
        if self._field.any() and (most <= self._field).all():
            light = uneven
        elif uneven.noise_levels < HALVED * light.noise_levels:
            left = float(most.max())
        if self._off(seen, light, TOLD) > MOST_LEVELS >= self._off(seen, STILL, QUARTER):
            return None, left
        effect = np.abs(self._fit.shown(light) - self._fit.before).max(axis=-1)
        apart = np.abs(seen - self._fit.before).max(axis=-1)
        lasting = (LASTING_PART * effect > light.noise_levels) & (apart < LASTING_PART * effect)
        return (STILL if lasting[self._fit.counts].mean() > LASTING else light), left

    def _refusal(self, seen: np.ndarray, found: ImageLight) -> str:
        counts, before = self._fit.counts, self._fit.before
        if np.ptp(seen[counts], axis=0).max() < 1.0 <= np.ptp(before[counts], axis=0).max():
            return "it is of one colour"
        if found.clipped > MOST_CLIPPED:
            return (
                f"its light has brought {found.clipped:.0%} of its pixels to the end of the "
                f"camera's range; at most {MOST_CLIPPED:.0%} can be read. Shorten the exposure"
            )
        straight = self._off(seen, STILL, QUARTER)
        for what, exchange in _EXCHANGED.items():
            other = np.abs(exchange(seen) - before).max(axis=-1)[counts]
            if straight > max(CLEARLY * float(np.quantile(other, QUARTER)), _LEAST_LEVELS):
                return f"it fits the background {what}"
        off = self._off(seen, found.light, QUARTER)
        if off > MOST_LEVELS:
            return (
                f"three quarters of its pixels differ from the background by more than {off:.0f} "
                f"levels, whatever the light; at most {MOST_LEVELS:g} is a press"
            )
        bright, gain = found.brightness, found.light.gain
        if (bright.min() < LEAST_LIGHT or bright.max() > MOST_LIGHT) or (
            gain.min() < LEAST_GAIN or gain.max() > MOST_GAIN
        ):
            both = min(bright.min(), gain.min()), max(bright.max(), gain.max())
            return (
                f"its light is {both[0]:.2g} to {both[1]:.2g} times the background's in the "
                f"channels; {LEAST_LIGHT:g} to {MOST_LIGHT:g} can be read. Give the untouched "
                "sensor in this light as background"
            )
        return ""

    def _off(self, seen: np.ndarray, light: Light, share: float) -> float:
        """Largest difference of a channel from the background in this light [levels], of the
        ``share`` of the pixels nearest to it."""
        apart = np.abs(seen - np.minimum(self._fit.shown(light), 255.0)).max(axis=-1)
        return float(np.quantile(apart[self._fit.counts], share))
