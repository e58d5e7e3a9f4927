# SPDX-License-Identifier: Apache-2.0
"""Brightness that changes in all channels alike, by rows or in a patch: light, not touch.

Lamps of several colours show a slope by channels that change apart, and on the two sides of a dent
in opposite directions. Two things change all channels by one factor. Light from the mains goes up
and down while a rolling shutter reads the rows: a sine along the rows, the same in every column.
And a coating that has worn since the background was taken, or dirt, is brighter or darker in a
patch, of one sign throughout. Both would be read as slopes, and so as a shallow dent. They are
found on small images, and divided out.

A gel whose untouched image itself varies in all channels alike is lit by lamps of one colour, which
show every slope like that: of those, patches say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from taccel_lab.reading.thumb import thumb

LEAST_LEVEL = 8.0
"""Levels below which a ratio is noise."""
GROUPS = 8
"""Groups of columns that bands have to be alike in."""
CYCLES = np.arange(1.5, 16.0, 0.25)
"""Bands over the image that are tried: fewer are a gradient, more are finer than the small
image's rows."""
BANDS_EXPLAINED = 0.7
"""Part of the rows' variation that one sine explains. Of 370 presses of twelve sensors some reach
it, but none with ``ALIKE`` columns."""
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


@dataclass(frozen=True)
class CommonGain:
    """A factor of all channels that is no touch."""

    factor: np.ndarray
    """Factor of each pixel, float32, shape [height_px, width_px]."""
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
    if mask is not None:
        levels = np.where(mask[..., None], levels, untouched)
    seen, known = thumb(levels), thumb(untouched)
    return _bands(seen, known, levels.shape[:2]) or _patch(seen, known, levels.shape[:2])


def _bands(seen: np.ndarray, known: np.ndarray, shape: tuple[int, int]) -> CommonGain | None:
    """A sine along the rows that most columns agree on, by least squares over its frequency."""
    ratio = np.log(np.maximum(seen, LEAST_LEVEL) / np.maximum(known, LEAST_LEVEL))
    rows = np.linspace(-1.0, 1.0, len(ratio))
    smooth = np.vander(rows, 3)

    def rest(values: np.ndarray) -> np.ndarray:
        """Values less what is quadratic along the rows: the gel sinks beside a press."""
        return values - smooth @ np.linalg.lstsq(smooth, values, rcond=None)[0]

    groups = np.array_split(ratio, GROUPS, axis=1)
    columns = np.stack([np.median(one.reshape(len(ratio), -1), axis=1) for one in groups], axis=1)
    common = rest(np.median(columns, axis=1))
    whole = float(np.square(common).sum())
    if whole < len(ratio) * LEAST_AMPLITUDE**2 / 2:
        return None

    def fitted(cycles: float) -> tuple[float, float, np.ndarray, np.ndarray]:
        """What is left of the sum of squares, the cycles, the wave's parts and their sizes."""
        phase = np.pi * cycles * rows
        wave = rest(np.stack([np.sin(phase), np.cos(phase)], axis=1))
        size = np.linalg.lstsq(wave, common, rcond=None)[0]
        return float(np.square(common - wave @ size).sum()), cycles, wave, size

    def best_of(tried: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray]:
        return min((fitted(cycles) for cycles in tried), key=lambda one: one[0])

    coarse = best_of(CYCLES[len(ratio) > 4 * CYCLES])[1]
    left, cycles, wave, fit = best_of(coarse + np.linspace(-0.25, 0.25, 11))
    amplitude = float(np.hypot(*fit))
    each = np.linalg.lstsq(wave, rest(columns), rcond=None)[0]
    alike = np.sort(fit @ each / max(amplitude**2, 1e-12))
    if (
        left > (1.0 - BANDS_EXPLAINED) * whole
        or amplitude < LEAST_AMPLITUDE
        or alike[1] < ALIKE[0]
        or alike[-2] > ALIKE[1]
    ):
        return None
    fine = np.pi * cycles * np.linspace(-1.0, 1.0, shape[0])
    factor = np.exp(fit[0] * np.sin(fine) + fit[1] * np.cos(fine)).astype(np.float32)
    return CommonGain(
        np.repeat(factor[:, None], shape[1], axis=1),
        f"light from the mains goes up and down along the rows by {amplitude:.1%} and was taken "
        "off: shut room light out, or set the exposure to a multiple of 10 ms (mains of 50 Hz) or "
        "8.3 ms (60 Hz)",
    )


def _patch(seen: np.ndarray, known: np.ndarray, shape: tuple[int, int]) -> CommonGain | None:
    """A factor that explains all change of a patch, of one sign."""
    sigma = max(min(seen.shape[:2]) / 60, 1.0)
    change, base = (cv2.GaussianBlur(each, (0, 0), sigma) for each in (seen - known, known))
    size = np.linalg.norm(change, axis=-1)
    patch = size > max(PATCH_LEVELS, PATCH_SHARE * float(size.max()))
    if not patch.any() or _one_factor(base - base.mean(axis=(0, 1)), base)[1] > OWN_FACTOR:
        return None
    share, explained = _one_factor(change, base, patch)
    if explained < ONE_FACTOR or abs(share[patch].sum()) < ONE_FACTOR * np.abs(share[patch]).sum():
        return None
    row, column = np.unravel_index(int(np.argmax(np.where(patch, size, 0.0))), size.shape)
    scale = shape[0] / len(seen)
    most = float(share[row, column])
    factor = cv2.resize(1.0 + share, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return CommonGain(
        factor.astype(np.float32),
        f"the background is old: around ({column * scale:.0f}, {row * scale:.0f}) px the gel is "
        f"{abs(most):.0%} {'brighter' if most > 0 else 'darker'} in all channels alike, as a worn "
        "coating or dirt is, which was taken off; give an image of the untouched gel as it is now "
        "(--background)",
    )


def _one_factor(
    change: np.ndarray, base: np.ndarray, where: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """The factor less 1 by which all channels of ``base`` change best, shape [h, w], and the part
    of the change's sum of squares that it explains ``where`` asked."""
    share = (change * base).sum(axis=-1) / np.maximum(np.square(base).sum(axis=-1), LEAST_LEVEL**2)
    left = np.square(change - share[..., None] * base).sum(axis=-1)
    counted = np.ones(left.shape, dtype=bool) if where is None else where
    whole = float(np.square(change).sum(axis=-1)[counted].sum())
    return share, 1.0 - float(left[counted].sum()) / max(whole, 1e-12)
