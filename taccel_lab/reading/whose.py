# SPDX-License-Identifier: Apache-2.0
"""Whether an image can be of the sensor that a background is of, in place and in which light.

A press leaves a part of the image as it was, but for a gain and an offset of each channel. Where
not even a quarter of the pixels is, or where the light has gone, or where the image fits the
background better with its channels or sides exchanged, whatever is read from it means nothing.

Dust, scratches, dots and the gel's edge stand still until somebody puts the gel back or turns the
lens. What is smooth of both images is taken off; the peak of their normalised cross-spectrum tells
the shift (Kuglin and Hines, Proc. IEEE Conf. Cybernetics and Society, 1975, 163-165).

The finest of that pattern is a gel's own, as a camera's noise is in a photograph (J. Lukas, J.
Fridrich and M. Goljan, IEEE Trans. Information Forensics and Security 1(2), 2006): the coating's
grain and dust. Another gel of the same kind in much the same light has none of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.reading.light import LightDrift, LightFit
from taccel_lab.reading.thumb import SmallImage, resized

QUARTER = 0.25
MOST_LEVELS = 12.0
"""Most that the quarter of the pixels nearest to the background may be off by, once the light is
alike [levels]. Twice the largest of 72 presses of a GelSight Mini and a DIGIT (FOTS), 6.0; presses
of two sensors that it was not chosen on have 3.0 (RVSATHU) and 1.2 (9DTact) at most, backgrounds of
other sensors 15 to 200."""
LEAST_GAIN, MOST_GAIN = 0.25, 4.0
"""Light outside this share of the background's is rejected; presses have 0.8 to 1.5."""
CLEARLY = 3.0
"""An image whose channels or sides are exchanged fits the background better by this factor."""
LEAST_LEVELS = 3.0
"""Differences below this are noise."""

_EXCHANGED: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "with red and blue exchanged (BGR for RGB?)": lambda image: image[..., ::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
}
SAME_PATTERN = 0.25
"""Part of the background's own variation that may be left once the light is alike, where both show
the same gel: frames of one unit leave 0.01 to 0.1, those of two units of a kind 0.4 to 1.5."""
MOST_PX = 3.0
"""Shift of a picture of 480 rows that readings bear: 9 px make a contact 47 % wider."""
ROWS = 480
GRAIN_SHARE = 1 / 40
"""What is smooth over more than this part of the shorter side is light, not pattern."""
ALIKE = 0.4
"""Correlation of the patterns from which on they are the same one."""
BETTER = 0.2
"""How much better they agree shifted than as they are."""
FINE_PX = 320
"""Longer side of the images whose finest pattern is looked at."""
FINE_SHARE = 1 / 80
FINE_AROUND = 8.0
"""Neighbourhoods that it is compared in, over what is smooth."""
FINE_STEPS = 4
"""Pixels by which it may have moved, of those images: readings bear as much."""
FEW = 0.02
"""Part of the neighbourhoods that may all be at rest in a press that fills the view."""
ITS_OWN = 0.115
"""Correlation of the finest patterns, in the neighbourhoods where they agree best, from which on
they are of one gel: 203 presses of eight units have 0.15 at least, 89 images of those and four more
with another unit's background 0.08 at most."""
UNEXPLAINED_LEVELS = 1.5
"""Robust standard deviation of what the light leaves of an image [levels] from which on that is
asked: images of another unit leave 2.5 at least, presses 0.3 to 4.4."""
GRAIN_LEVELS, GRAIN_KEPT = 0.35, 0.29
"""Least standard deviation of a pattern [levels] on pixels twice as wide, and the part of its
variance that stays there: noise of a camera keeps a quarter."""


def unlike(
    image: np.ndarray, background: np.ndarray, light: LightDrift, mask: np.ndarray | None = None
) -> str | None:
    """Why an image is not of the background's sensor, or None.

    Args:
        image: RGB levels, float, shape [height, width, 3].
        background: Untouched sensor, the same.
        light: Of the image against the background (``fit_light``).
        mask: Pixels that count, bool, shape [height, width].
    """
    return not_of(SmallImage.of(background, mask), SmallImage.of(image, mask), light)


def not_of(known: SmallImage, seen: SmallImage, light: LightDrift) -> str | None:
    """Why an image is not of the sensor whose untouched image is ``known``, or None; ``light`` is
    its own against that."""
    known, seen = known.blocks, seen.blocks
    usable = known.usable & seen.usable
    if _is_plain(seen.levels[usable]) and not _is_plain(known.levels[usable]):
        return "it is of one colour"
    gain = np.asarray(light.gain, dtype=float)
    if not ((gain > LEAST_GAIN) & (gain < MOST_GAIN)).all():
        return (
            f"its light is {gain.min():.2g} to {gain.max():.2g} times the background's in the "
            f"channels; {LEAST_GAIN:g} to {MOST_GAIN:g} can be read"
        )
    if _off(seen.levels, known.levels, usable) > LEAST_LEVELS:
        for what, exchange in _EXCHANGED.items():
            # Only where both count: a mask is exchanged, too.
            both = usable & exchange(seen.usable[..., None])[..., 0]
            straight = _off(seen.levels, known.levels, both)
            if straight > max(
                CLEARLY * _off(exchange(seen.levels), known.levels, both), LEAST_LEVELS
            ):
                return f"it fits the background {what}"
    off = _off(light.within(seen).removed(seen.levels), known.levels, usable)
    if off > MOST_LEVELS:
        return (
            f"three quarters of its pixels differ from the background by more than {off:.0f} "
            f"levels, whatever the light; at most {MOST_LEVELS:g} is a press"
        )
    return None


def _is_plain(levels: np.ndarray) -> bool:
    """Say whether blocks, [n, 3], are of one colour."""
    return len(levels) > 0 and float(np.ptp(levels, axis=0).max()) < 1.0


def _off(levels: np.ndarray, known: np.ndarray, where: np.ndarray) -> float:
    """Largest difference of a channel, of the quarter of blocks [h, w, 3] nearest to the
    background's ones, of those ``where`` asked; 0 where there are none."""
    off = np.abs(levels - known).max(axis=-1)[where]
    return float(np.sort(off)[int(QUARTER * (len(off) - 1))]) if len(off) else 0.0


def light_of_background(
    background: np.ndarray, known: np.ndarray, mask: np.ndarray | None = None
) -> LightDrift:
    """Light of ``background`` against that of the profile, RGB levels [height, width, 3].

    Of one gel on two days it is gain, offset and gradient. Of another unit, whose lamps throw
    another pattern, it is the gain of each channel's mean: a lamp that is brighter by a part makes
    the untouched gel and the colours of a slope brighter by that part. InputError of a picture that
    is black or white all over.
    """
    seen, old = (SmallImage.of(image, mask) for image in (background, known))
    counted = seen.usable
    if _is_plain(seen.levels[counted]) and not 1.0 < seen.levels[counted].mean() < 254.0:
        raise InputError(
            "the background is black or white all over; give an image of the untouched sensor"
        )
    means = [small.levels[counted].mean(axis=0) for small in (seen, old)]
    ratio = np.maximum(means[0], 1.0) / np.maximum(means[1], 1.0)
    # What a background does not tell, an even one above all, is a lamp's brightness, not an offset.
    light = LightFit(replace(old, levels=old.levels * ratio)).still(seen)
    light = replace(light, gain=light.gain * ratio)
    left = seen.levels - light.within(seen).apply(old.levels)
    own = old.levels - np.median(old.levels, axis=(0, 1))
    spread, whole = (float(np.median(np.abs(part[counted]))) for part in (left, own))
    if spread <= SAME_PATTERN * whole:
        return light
    return LightDrift(ratio, np.zeros(3))


class Pattern:
    """Pattern of an untouched gel that stands still, and that of frames beside it."""

    def __init__(self, known: SmallImage, smooth_share: float = GRAIN_SHARE) -> None:
        """
        Args:
            known: The untouched image.
            smooth_share: Part of the shorter side over which what is smooth is no pattern.
        """
        import cv2

        height, width = known.levels.shape[:2]
        self._sigma = max(smooth_share * min(height, width), 1.0)
        self._window = cv2.createHanningWindow((width, height), cv2.CV_32F)
        self._known = self._grain(known, np.ones(3))
        self._spectrum = self._spectrum_of(self._known)

    @cached_property
    def is_clear(self) -> bool:
        """Whether there is one, and not a camera's noise alone."""
        return _is_clear(self._known)

    def agreement(self, seen: SmallImage, gain: np.ndarray) -> float | None:
        """Correlation of the patterns in the few neighbourhoods where they agree best, wherever
        within ``FINE_STEPS`` pixels the frame has its own; None where its noise hides it. ``gain``
        as of ``shift``."""
        from scipy.fft import irfft2

        grain = self._grain(seen, gain)
        if not _is_clear(grain):
            return None
        together = np.asarray(
            irfft2(self._spectrum_of(grain) * self._spectrum.conj(), s=grain.shape)
        )
        steps = np.arange(-FINE_STEPS, FINE_STEPS + 1)
        near = together[np.ix_(steps % len(together), steps % together.shape[1])]
        down, right = np.unravel_index(int(np.argmax(near)), near.shape)
        moved = np.roll(self._known, (int(steps[down]), int(steps[right])), (0, 1))
        if seen.share is not None:
            moved = moved * (seen.share > 0)
        return float(np.quantile(self._alike(grain, moved, FINE_AROUND), 1.0 - FEW))

    def shift(self, seen: SmallImage, gain: np.ndarray | None = None) -> tuple[float, float] | None:
        """How far the pattern of a frame lies right of and below that of the untouched image [px];
        None where it lies there, or where there is too little of one to tell.

        ``gain``: its light's gain of each channel, shape [3].
        """
        from scipy.fft import irfft2

        grain = self._grain(seen, np.ones(3) if gain is None else gain)
        both = self._spectrum_of(grain) * self._spectrum.conj()
        both /= np.maximum(np.abs(both), 1e-12)
        right, down = _peak(np.asarray(irfft2(both, s=grain.shape)))
        height, width = seen.shape_px
        scale_x, scale_y = width / grain.shape[1], height / grain.shape[0]
        found = right * scale_x, down * scale_y
        if max(map(abs, found)) <= MOST_PX * min(height, width) / ROWS:
            return None
        known = self._known if seen.share is None else self._known * (seen.share > 0)
        straight = self._correlation(grain, known)
        moved = np.roll(known, (round(down), round(right)), (0, 1))
        if straight + BETTER > 1.0 or self._correlation(grain, moved) < max(
            ALIKE, straight + BETTER
        ):
            return None
        return found

    def _grain(self, small: SmallImage, gain: np.ndarray) -> np.ndarray:
        """Fine structure of the mean of the channels [levels], float32, shape [h, w]."""
        import cv2

        grey = cv2.transform(small.levels, (1.0 / (3.0 * gain))[None])
        if small.share is None:
            return grey - self._smooth(grey)
        total = self._smooth(small.share)
        mean = self._smooth(grey * small.share) / np.maximum(total, 1e-3)
        return (grey - mean) * small.share

    def _smooth(self, values: np.ndarray, sigmas: float = 1.0) -> np.ndarray:
        """Gaussian mean, by an image whose pixels are half as wide as the Gaussian."""
        import cv2

        sigma = sigmas * self._sigma
        height, width = values.shape
        times = max(sigma / 2.0, 1.0)
        small = resized(values, (max(1, round(width / times)), max(1, round(height / times))))
        small = cv2.GaussianBlur(small, (0, 0), sigma * len(small) / height)
        return cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)

    def _spectrum_of(self, grain: np.ndarray) -> np.ndarray:
        from scipy.fft import rfft2

        return np.asarray(rfft2(grain * self._window))

    def _correlation(self, one: np.ndarray, other: np.ndarray) -> float:
        """Median over the picture of the correlation in a neighbourhood: a contact has no pattern
        of the background."""
        return float(np.median(self._alike(one, other, 2.0)))

    def _alike(self, one: np.ndarray, other: np.ndarray, sigmas: float) -> np.ndarray:
        """Correlation of two patterns in the neighbourhood of each place, shape [h, w]."""
        both, own, others = (
            self._smooth(v, sigmas) for v in (one * other, one * one, other * other)
        )
        return both / np.sqrt(np.maximum(own * others, 1e-12))


def _is_clear(grain: np.ndarray) -> bool:
    """Whether fine structure [levels], [h, w], is more than a camera's noise."""
    height, width = grain.shape
    wide = resized(grain, (max(1, width // 2), max(1, height // 2)))
    kept = float(wide.var()) / max(float(grain.var()), 1e-12)
    return float(wide.std()) > GRAIN_LEVELS and kept > GRAIN_KEPT


def _peak(values: np.ndarray) -> tuple[float, float]:
    """Place of the largest of periodic values, to the right and down from the first, to a part of
    a pixel: the mean over its neighbours, weighed by what they have."""
    height, width = values.shape
    row, column = np.unravel_index(int(np.argmax(values)), values.shape)
    rows, columns = row + np.arange(-2, 3), column + np.arange(-2, 3)
    weight = np.maximum(values[np.ix_(rows % height, columns % width)], 0.0)
    weight = weight / weight.sum() if weight.sum() > 0 else np.full((5, 5), 0.04)
    right, down = float(weight.sum(axis=0) @ columns), float(weight.sum(axis=1) @ rows)
    return (
        right - width if right > width / 2 else right,
        down - height if down > height / 2 else down,
    )
