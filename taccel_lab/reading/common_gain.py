# SPDX-License-Identifier: Apache-2.0
"""Brightness that changes in all channels alike, by rows, in a patch, all over: light, no touch.

Lamps of several colours show a slope by channels that change apart, and on the two sides of a dent
in opposite directions. Two things change all channels by one factor. Light from the mains goes up
and down while a rolling shutter reads the rows: a sine along the rows, the same in every column.
And a coating that has worn since the background was taken, or dirt, is brighter or darker in a
patch, of one sign throughout. Both would be read as slopes, and so as a shallow dent. They are
found on small images, and divided out.

A lamp that has become weaker over a part of the view changes one colour smoothly, where a dent has
rims and shows other colours on its other side.

A lens that darkens the corners, and a camera whose tone curve has changed, alter the whole image by
a factor that is smooth over it, or over the levels: one for all channels, once each has its own
gain, offset and gradient. Presses have next to nothing of that.

A gel whose untouched image itself varies in all channels alike is lit by lamps of one colour, which
show every slope like that: of those, patches say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from taccel_lab.reading.light import unit_position
from taccel_lab.reading.thumb import SmallImage, resized

LEAST_LEVEL = 8.0
"""Levels below which a ratio is noise."""
COLUMNS_TOGETHER = 4
"""Columns of the small image whose mean stands for them."""
GROUPS = 8
"""Groups of columns that bands have to be alike in."""
CYCLES = np.arange(1.5, 16.0, 0.25)
"""Bands over the image that are tried: fewer are a gradient, more are finer than the small
image's rows."""
BANDS_EXPLAINED = 0.7
"""Part of the rows' variation that one sine explains. Of 370 presses of twelve sensors some reach
it, but none with ``ALIKE`` columns."""
BETWEEN_TRIED = 0.2
"""Part of it, at most, that a sine between two that are tried explains more than either."""
ALIKE = 0.6, 1.4
"""Amplitude in the columns, but one group on either side, as a part of the common one."""
LEAST_AMPLITUDE = 0.004
PATCH_LEVELS, PATCH_SHARE = 2.0, 0.25
"""A patch is what changes by so many levels and by so large a part of the largest change."""
ONE_FACTOR = 0.98
"""Part of the change (sum of squares) that one factor for all channels explains in a patch, and
part of it that has one sign: worn patches have 0.999; 370 presses 0.77 at most, of which 0.55 of
one sign, where the background has less than ``OWN_FACTOR``."""
OWN_FACTOR = 0.8
"""Part of the background's own variation that one factor explains. Lamps of several colours leave
0.2 to 0.7, those of one 0.84 and more."""


SHADE_EXPLAINED = 0.82
"""Part of the change (sum of squares), beside each channel's own light, that shade and tone curve
explain: 0.85 to 1.00 of darkened corners and gammas, 0.79 at most of worn patches, 0.06 at most of
170 presses of seven units."""
MIDDLE_SHARE = 0.3
"""Part of what a lens does to corners that it may do beside them."""
MOST_SHADE = 0.5, 2.0
"""Limits of such a factor."""
ONE_COLOUR, SMOOTH = 0.985, 0.85
"""Part of the same change that has one colour, and part of that which is left when it is blurred
over ``WIDE_SHARE`` of the image's height. One lamp weaker over a part of the view has 0.995 and
0.89 at least; 100 presses of nine units 0.95 and 0.85 at most. Of drawn rollers, ridges and half
planes, whose slopes have one direction, the most have 0.974 with 0.73; a ball of 50 mm has 0.51
with 0.89: a dent has rims, and lamps on two sides."""
WIDE_SHARE = 1 / 12
LEAST_SHADE_LEVELS = 0.3
"""Root mean square of what is left of the change beside each channel's own light."""


@dataclass(frozen=True)
class CommonGain:
    """A factor of all channels that is no touch."""

    factor: np.ndarray
    """Factor of each pixel, float32, shape [height_px, width_px, 1], or of each level, with 3."""
    remark: str
    """What was found and what to do, a sentence."""


def common_gain(
    levels: np.ndarray, untouched: np.ndarray, mask: np.ndarray | None = None
) -> CommonGain | None:
    """The common factor of an image; None where there is none.

    Args:
        levels: RGB levels in the light of ``untouched``, float, shape [height_px, width_px, 3].
        untouched: The untouched sensor, likewise.
        mask: Pixels that count, bool, shape [height_px, width_px].
    """
    known, seen = (SmallImage.of(each, mask) for each in (untouched, levels))
    return CommonGains(known).of(seen.levels)


class CommonGains:
    """Looks for a common factor in frames of one sensor; what it needs of the untouched image is
    made once."""

    def __init__(self, known: SmallImage) -> None:
        """``known``: the untouched image."""
        self._known, self._shape_px = known.levels, known.shape_px
        self._counted = None if known.share is None else (known.share > 0)[..., None]
        height, width = self._known.shape[:2]
        self._columns = max(GROUPS, width // COLUMNS_TOGETHER // GROUPS * GROUPS), height
        self._half = max(1, width // 2), max(1, height // 2)
        self._rows = self._logs(self._known)
        self._base = self._blurred(self._known)
        own = self._base - self._base.mean(axis=(0, 1))
        self._one_colour = _one_factor(own, self._base)[1] > OWN_FACTOR
        own, shades = _own_light(self._base), _shades(self._base)
        self._own_light = np.linalg.qr(own)[0]
        self._own_of_shade = np.linalg.lstsq(own, shades, rcond=None)[0]
        self._shades = shades - own @ self._own_of_shade

    def of(self, levels: np.ndarray) -> CommonGain | None:
        """The common factor of a frame made small, levels in the untouched image's light, shape
        [h, w, 3]; None where there is none."""
        levels = self._counting(levels)
        if self._one_colour:
            return self.corners(levels) or self._bands(levels)
        change = self._beside_own_light(levels)
        return (
            self._shade(change) or self._lamp(change) or self._bands(levels) or self._patch(levels)
        )

    def corners(self, levels: np.ndarray) -> CommonGain | None:
        """The same, where it makes corners darker or brighter and leaves the middle: lamps of one
        colour tell nothing else from a touch."""
        size = self._shade_size(self._beside_own_light(self._counting(levels)))
        # A factor that grows with the fourth power from the middle, and none with the second.
        if size is None or np.abs(size[:3]).sum() > MIDDLE_SHARE * 4 * abs(size[3]):
            return None
        return self._shade_of(size)

    def _counting(self, levels: np.ndarray) -> np.ndarray:
        """Levels, float32, with those of the untouched image where no pixel counts."""
        levels = levels.astype(np.float32)
        return levels if self._counted is None else np.where(self._counted, levels, self._known)

    def _logs(self, levels: np.ndarray) -> np.ndarray:
        """Logarithms of means over columns that lie together."""
        return np.log(np.maximum(resized(levels, self._columns), LEAST_LEVEL))

    def _blurred(self, levels: np.ndarray) -> np.ndarray:
        """Levels at half the size, without noise."""
        small = resized(levels, self._half)
        return cv2.GaussianBlur(small, (0, 0), max(min(small.shape[:2]) / 60, 0.5))

    def _bands(self, levels: np.ndarray) -> CommonGain | None:
        """A sine along the rows that most columns agree on, by least squares over its frequency."""
        count = len(levels)
        ratio = self._logs(levels) - self._rows
        columns = _median(ratio.reshape(count, GROUPS, -1)).astype(np.float64)
        common = _rest(_median(columns))
        whole = float(np.square(common).sum())
        if whole < count * LEAST_AMPLITUDE**2 / 2:
            return None
        tried, waves = _tried_waves(count)
        explained = _explained(waves, common)
        if explained.max() < (BANDS_EXPLAINED - BETWEEN_TRIED) * whole:
            return None
        near = tried[np.argmax(explained)] + np.linspace(-0.25, 0.25, 11)
        explained = _explained(_waves(count, near), common)
        best = int(np.argmax(explained))
        cycles = near[best : best + 1]
        wave = _sines(count, cycles)[0]
        fit = np.linalg.lstsq(_rest(wave.T).T, common, rcond=None)[0]
        each = np.linalg.lstsq(_rest(wave.T).T, _rest(columns.T).T, rcond=None)[0]
        amplitude = float(np.hypot(*fit))
        alike = np.sort(fit @ each / max(amplitude**2, 1e-12))
        if (
            explained[best] < BANDS_EXPLAINED * whole
            or amplitude < LEAST_AMPLITUDE
            or alike[1] < ALIKE[0]
            or alike[-2] > ALIKE[1]
        ):
            return None
        fine = np.pi * cycles * np.linspace(-1.0, 1.0, self._shape_px[0])
        factor = np.exp(fit[0] * np.sin(fine) + fit[1] * np.cos(fine)).astype(np.float32)
        return CommonGain(
            np.repeat(factor[:, None], self._shape_px[1], axis=1)[..., None],
            f"light from the mains goes up and down along the rows by {amplitude:.1%} and was "
            "taken off: shut room light out, or set the exposure to a multiple of 10 ms (mains of "
            "50 Hz) or 8.3 ms (60 Hz)",
        )

    def _patch(self, levels: np.ndarray) -> CommonGain | None:
        """A factor that explains all change of a patch, of one sign."""
        change = self._blurred(levels) - self._base
        size = np.sqrt(np.einsum("hwc,hwc->hw", change, change))
        patch = size > max(PATCH_LEVELS, PATCH_SHARE * float(size.max()))
        if not patch.any():
            return None
        share, explained = _one_factor(change[patch], self._base[patch])
        if explained < ONE_FACTOR or abs(share.sum()) < ONE_FACTOR * np.abs(share).sum():
            return None
        share = _one_factor(change, self._base)[0]
        row, column = np.unravel_index(int(np.argmax(size)), size.shape)
        scale = self._shape_px[0] / len(size)
        most = float(share[row, column])
        factor = cv2.resize(1.0 + share, self._shape_px[::-1], interpolation=cv2.INTER_LINEAR)
        return CommonGain(
            factor.astype(np.float32)[..., None],
            f"the background is old: around ({column * scale:.0f}, {row * scale:.0f}) px the gel "
            f"is {abs(most):.0%} {'brighter' if most > 0 else 'darker'} in all channels alike, as "
            "a worn coating or dirt is, which was taken off; give an image of the untouched gel as "
            "it is now (--background)",
        )

    def _beside_own_light(self, levels: np.ndarray) -> np.ndarray | None:
        """Change of blurred levels beside each channel's own light, [h w 3]; None of next to
        none."""
        change = (self._blurred(levels) - self._base).reshape(-1)
        change = change - self._own_light @ (self._own_light.T @ change)
        enough = float(np.square(change).sum()) >= len(change) * LEAST_SHADE_LEVELS**2
        return change if enough else None

    def _lamp(self, change: np.ndarray | None) -> CommonGain | None:
        """A smooth change of one colour."""
        if change is None:
            return None
        pixels = change.reshape(-1, 3)
        powers, colours = np.linalg.eigh(pixels.T @ pixels)
        if powers[-1] < ONE_COLOUR * powers.sum():
            return None
        size = (pixels @ colours[:, -1]).reshape(self._base.shape[:2])
        smooth = cv2.GaussianBlur(size, (0, 0), WIDE_SHARE * len(size))
        left = float(np.square(size - smooth).sum())
        if left > (1.0 - SMOOTH) * float(np.square(size).sum()):
            return None
        share = size[..., None] * colours[:, -1] / np.maximum(self._base, LEAST_LEVEL)
        factor = cv2.resize(1.0 + share, self._shape_px[::-1], interpolation=cv2.INTER_LINEAR)
        return CommonGain(
            np.clip(factor, *MOST_SHADE).astype(np.float32),
            "the light of one lamp spreads over the gel otherwise than in the background, as was "
            "taken off: look at the lamps, or give an image of the untouched gel as it is now "
            "(--background)",
        )

    def _shade(self, change: np.ndarray | None) -> CommonGain | None:
        """A smooth factor and a tone curve that explain most of the change all over the image."""
        size = self._shade_size(change)
        return None if size is None else self._shade_of(size)

    def _shade_size(self, change: np.ndarray | None) -> np.ndarray | None:
        """Parameters of ``_shades``, [5], where they explain enough of ``_beside_own_light``."""
        if change is None:
            return None
        whole = float(np.square(change).sum())
        size = np.linalg.lstsq(self._shades, change, rcond=None)[0]
        left = float(np.square(change - self._shades @ size).sum())
        return size if 1.0 - left / whole >= SHADE_EXPLAINED else None

    def _shade_of(self, size: np.ndarray) -> CommonGain:
        most = np.abs(self._shades * size).max(axis=0)
        what = (
            "the camera's tone curve is another than that of"
            if most[-1] > most[:-1].max()
            else "corners and middle of the image are lit otherwise than in"
        )
        known = np.maximum(self._known, LEAST_LEVEL)
        own = _own_light(known, self._base) @ (self._own_of_shade @ size)
        share = (_shades(known) @ size - own).reshape(known.shape) / known
        factor = cv2.resize(1.0 + share, self._shape_px[::-1], interpolation=cv2.INTER_LINEAR)
        return CommonGain(
            np.clip(factor, *MOST_SHADE).astype(np.float32),
            f"{what} the background, as was taken off: fix exposure, gamma and white balance, "
            "or give an image of the untouched gel as it is now (--background)",
        )


def _own_light(base: np.ndarray, middle: np.ndarray | None = None) -> np.ndarray:
    """Changes of levels [h, w, 3] by each channel's gain, about the mean of ``middle``, offset and
    gradient, [3 h w, 12]."""
    means = (base if middle is None else middle).mean(axis=(0, 1))
    across, down = unit_position(*base.shape[:2])
    found = np.zeros((*base.shape, 3, 4))
    for channel in range(3):
        level = base[..., channel]
        terms = (level - means[channel], np.ones_like(level), across + 0 * down, down + 0 * across)
        found[:, :, channel, channel] = np.stack(terms, axis=-1)
    return found.reshape(base.size, 12)


def _shades(base: np.ndarray) -> np.ndarray:
    """Changes of levels [h, w, 3] by smooth factors over the image and one over the levels,
    [3 h w, 5]."""
    across, down = (each[..., None] for each in unit_position(*base.shape[:2]))
    round_ = across**2 + down**2
    factors = (across**2, across * down, down**2, round_**2, base / 255.0)
    return np.stack([(factor * base).reshape(-1) for factor in factors], axis=-1)


def _median(values: np.ndarray) -> np.ndarray:
    """Medians along the last axis; whole rows are sorted faster than parted."""
    ordered, count = np.sort(values, axis=-1), values.shape[-1]
    return 0.5 * (ordered[..., (count - 1) // 2] + ordered[..., count // 2])


def _rest(values: np.ndarray) -> np.ndarray:
    """Values [..., row] less what is quadratic along the rows: the gel sinks beside a press."""
    smooth = _smooth_rows(values.shape[-1])
    return values - (values @ smooth) @ smooth.T


@cache
def _smooth_rows(count: int) -> np.ndarray:
    """Orthonormal parabolas over so many rows, shape [row, 3]."""
    return np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), 3))[0]


def _sines(count: int, cycles: np.ndarray) -> np.ndarray:
    """Sines and cosines of so many cycles over the rows, shape [cycle, row, 2]."""
    phase = np.pi * cycles[:, None] * np.linspace(-1.0, 1.0, count)
    return np.stack([np.sin(phase), np.cos(phase)], axis=-1)


def _waves(count: int, cycles: np.ndarray) -> np.ndarray:
    """Orthonormal waves of so many cycles, without parabolas, shape [cycle, row, 2]."""
    return np.linalg.qr(_rest(_sines(count, cycles).swapaxes(1, 2)).swapaxes(1, 2))[0]


@cache
def _tried_waves(count: int) -> tuple[np.ndarray, np.ndarray]:
    """The cycles that are tried over so many rows, and their waves."""
    cycles = CYCLES[count > 4 * CYCLES]
    return cycles, _waves(count, cycles)


def _explained(waves: np.ndarray, common: np.ndarray) -> np.ndarray:
    """Part of the sum of squares of values [row] that each of the waves explains, [cycle]."""
    return np.square(np.tensordot(waves, common, (1, 0))).sum(axis=-1)


def _one_factor(change: np.ndarray, base: np.ndarray) -> tuple[np.ndarray, float]:
    """The factor less 1 by which all channels of ``base`` [..., 3] change best, [...], and the part
    of the change's sum of squares that it explains."""
    share = (change * base).sum(axis=-1) / np.maximum(np.square(base).sum(axis=-1), LEAST_LEVEL**2)
    left = change - share[..., None] * base
    return share, 1.0 - float(np.square(left).sum()) / max(float(np.square(change).sum()), 1e-12)
