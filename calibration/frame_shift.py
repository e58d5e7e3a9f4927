# SPDX-License-Identifier: Apache-2.0
"""Frames that a camera's link sent shifted, whole or from some row on: the light on the gel tells.

A gel that moves takes its dots and its dust along; the light of the lamps and the shade of the
housing stay where they are. In a frame that lost data on its way everything moves. Shifts that the
fine structure allows are the peaks of the normalised cross-spectrum (Kuglin and Hines, Proc. IEEE
Conf. Cybernetics and Society, 1975, 163-165), a lattice of dots has one a pitch. Each is then held
against the light, block by block: is the change from frame to frame the one that this shift makes?
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from scipy.fft import irfft2, rfft2

from taccel_lab.reading.dots.blobs import grey_levels
from taccel_lab.robust_fit import spread_about_zero

_LONGEST_PX = 320
"""Larger frames are shrunk to this: light is smooth."""
_CELL_PX = 4
_ROUND_DOT, _BLURRED_PX = 1.3, 2.0
"""Dots are taken out of the light by a window of this many diameters, and this on each side."""
_BANDS, _COLUMNS = 12, 8
"""Blocks of a frame."""
_PEAKS = 6
_NEAR = 2
"""Peaks are largest within this many pixels."""
_LEAST_LEVELS, _NOISES = 0.3, 4.0
"""A block tells something where the shift would change its light by more than this, and by more
than its noise."""
_SEEN = 0.25
"""Part of the usual block that has to lie in both frames."""
_EXPLAINED = 0.5
"""A shift that leaves less than this part of a block's change, in squares, explains it."""
_SHOWN, _SMALL_PX = 0.4, 6
"""Most by which a block may show more or less than all of a shift, where that is smaller than this
along the rows: a gel that moves does as much to the fine structure."""
_OF_BAND = 0.6
"""Share of a band's blocks that a shift has to explain."""
_WHOLE = 0.8
"""Share of the bands from which on a frame is shifted as a whole."""
_CLEAR = 0.5
"""Least agreement of the fine structure there, as a part of the best one."""
_SHARE = 0.8
"""And that of some rows alone, as a part of their share of the frame."""
_GONE = 0.5
"""Most that is left of the fine structure's agreement in place, where all of it is shifted."""
_TRACE = 0.1
"""And where that alone says so, a press having changed most of the light."""
_PART_PX = 3
"""Least shift of some rows alone, in pixels of the shrunk frame."""
_DOWN = 0.125
"""Most that they are shifted up or down, as a part of the height: what is lost is a few rows."""
_BETWEEN = 2
"""Bands of a frame shifted in part that may be neither shifted nor in place."""
_TELLING = 3
"""Blocks of a band that have to tell something."""
_TOLD = 0.4
"""Least part of the bands that has to tell something: light that is not even varies all over."""
_RUN = 2
"""Bands in a row that are shifted in a shifted frame. Frames of a real press of a GelSight Mini, 1
to 110 frames apart, have none."""


@dataclass(frozen=True)
class Look:
    """The parts of a frame that are compared with another's."""

    size_px: tuple[int, int]
    """Width and height of the frame."""
    light: np.ndarray
    """Grey levels without dots, coarse and smooth, float32."""
    noise: float
    """Standard deviation of its cells [levels]."""
    spectrum: np.ndarray
    """Phases of the shrunk frame, complex, as ``rfft2`` gives them."""
    shape: tuple[int, int]
    """Height and width of the shrunk frame."""

    @classmethod
    def at(cls, frame: np.ndarray, dot_radius_px: float = 0.0, sign: int = -1) -> Look:
        """A look at a frame.

        Args:
            frame: RGB or grey levels, shape [height_px, width_px] or [.., 3].
            dot_radius_px: Radius of dots on the gel; 0 for none.
            sign: -1 for dark dots, 1 for bright ones.
        """
        grey = grey_levels(frame)
        size = grey.shape[1], grey.shape[0]
        shrunk = max(1.0, max(size) / _LONGEST_PX)
        if shrunk > 1.0:
            small = [max(1, round(side / shrunk)) for side in size]
            grey = cv2.resize(grey, small, interpolation=cv2.INTER_AREA)
        light = grey
        if dot_radius_px > 0:
            window = 2 * int(np.ceil(_ROUND_DOT * dot_radius_px / shrunk + _BLURRED_PX)) + 1
            way = cv2.MORPH_CLOSE if sign < 0 else cv2.MORPH_OPEN
            # Noise is larger where there is more bright gel in the window: off first.
            light = cv2.GaussianBlur(grey, (0, 0), 1)
            light = cv2.morphologyEx(light, way, np.ones((window, window), np.uint8))
        cells = [max(1, side // _CELL_PX) for side in grey.shape[::-1]]
        light = cv2.resize(light, cells, interpolation=cv2.INTER_AREA)
        # Of the smoothed cells, by the second differences of those before: light has hardly any.
        noise = spread_about_zero(np.diff(light, 2, axis=1).ravel()) / np.sqrt(24 * np.pi)
        light = cv2.GaussianBlur(light, (0, 0), 1)
        spectrum = np.asarray(rfft2(grey - grey.mean()))
        height, width = grey.shape
        phases = spectrum / np.maximum(np.abs(spectrum), 1e-6)
        return cls(size, light, noise, phases, (height, width))


@dataclass(frozen=True)
class Shift:
    """Displacement of a frame's rows against another frame."""

    right_px: float
    down_px: float
    rows: range
    """Rows that are; all of them where the frame is shifted as a whole."""


def shift_between(before: Look, after: Look) -> Shift | None:
    """How ``after`` is shifted against ``before``, as a whole or in some of its rows; None where it
    is not, or where the light is too even to tell. Both have one size."""
    best, found = 0, None
    match = _match(before, after)
    # Less agreement is enough for no run of bands.
    least = _SHARE * _RUN / _BANDS * match.max()
    for right, down in _peaks(match):
        if right == down == 0 or match[down, right] < least:
            continue
        moved, still, telling = _bands(before, after, right, down)
        run = _longest_run(moved)
        if len(run) < max(_RUN, best + 1) or telling.sum() < _TOLD * _BANDS:
            continue
        height = after.size_px[1]
        here, there = float(match[0, 0]), float(match[down, right])
        if moved.sum() >= _WHOLE * telling.sum() or here < _TRACE * there == _TRACE * match.max():
            rows = range(height)
            sure = here < _GONE * there and there >= _CLEAR * match.max()
        else:
            rows = range(run.start * height // _BANDS, run.stop * height // _BANDS)
            sure = max(abs(right), abs(down)) >= _PART_PX and abs(down) <= _DOWN * match.shape[0]
            sure &= there >= _SHARE * len(run) / _BANDS * match.max()
            sure &= (moved | still).sum() >= telling.sum() - _BETWEEN
        if sure:
            best, shrunk = len(run), max(1.0, max(after.size_px) / _LONGEST_PX)
            found = Shift(shrunk * right, shrunk * down, rows)
    return found


@lru_cache(maxsize=4)
def _fine(shape: tuple[int, int]) -> np.ndarray:
    """Gaussian over the frequencies of an image of ``shape``: of a pixel's width."""
    rows, columns = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    return np.exp(-2.0 * np.pi**2 * (rows**2 + columns**2)).astype(np.float32)


def _match(before: Look, after: Look) -> np.ndarray:
    """How well the fine structure of both agrees, by the shift down and to the right."""
    product = after.spectrum * before.spectrum.conj() * _fine(after.shape)
    return np.asarray(irfft2(product, s=after.shape), dtype=np.float32)


def _peaks(match: np.ndarray) -> list[tuple[int, int]]:
    """The likeliest shifts to the right and down, in pixels of the shrunk frames."""
    height, width = match.shape
    around = cv2.dilate(np.pad(match, _NEAR, mode="wrap"), np.ones((2 * _NEAR + 1,) * 2, np.uint8))
    tops = np.flatnonzero(match >= around[_NEAR:-_NEAR, _NEAR:-_NEAR])
    tops = tops[np.argsort(-match.ravel()[tops], kind="stable")][:_PEAKS]
    rows, columns = np.unravel_index(tops, match.shape)
    return [
        (int(x - width * (x > width // 2)), int(y - height * (y > height // 2)))
        for x, y in zip(columns, rows, strict=True)
    ]


def _bands(before: Look, after: Look, right: int, down: int) -> list[np.ndarray]:
    """Bands of rows that a shift explains, those that it does not, and those that tell something of
    it, bool, shape [band]."""
    cells = before.light.shape
    across, along = cells[1] / before.shape[1], cells[0] / before.shape[0]
    move = np.array([[1, 0, right * across], [0, 1, down * along]], dtype=np.float32)
    nowhere = (float("nan"),) * 4
    moved = cv2.warpAffine(before.light, move, cells[::-1], borderValue=nowhere)
    both = np.isfinite(moved)
    if not both.any():
        return [np.zeros(_BANDS, bool)] * 3
    expected, change = moved - before.light, after.light - before.light
    # The lamps may be a little brighter.
    expected, change = (
        np.where(both, part - np.median(part[both]), 0.0) for part in (expected, change)
    )
    cell_count = _by_block(both.astype(float))
    size, straight, left = (_by_block(v**2) for v in (expected, change, change - expected))
    least = max(_LEAST_LEVELS, _NOISES * max(before.noise, after.noise))
    telling = (cell_count >= _SEEN * cell_count.max()) & (size > cell_count * least**2)
    enough = telling.sum(axis=1) >= _TELLING
    if abs(right) < _SMALL_PX:
        # Of a small shift the light shows all, not twice as much or half.
        shown = 0.5 * (size + straight - left) / np.maximum(size, 1e-9)
        left = np.where(np.abs(shown - 1.0) < _SHOWN, left, straight)
    by_band = (
        enough & ((telling & one).sum(axis=1) >= _OF_BAND * telling.sum(axis=1))
        for one in (left < _EXPLAINED * straight, straight < _EXPLAINED * left)
    )
    return [*by_band, enough]


def _by_block(values: np.ndarray) -> np.ndarray:
    """Sums over the blocks, shape [band, column]."""
    rows, columns = (
        np.linspace(0, size, count + 1).astype(int)[:-1]
        for size, count in zip(values.shape, (_BANDS, _COLUMNS), strict=True)
    )
    return np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)


def _longest_run(shifted: np.ndarray) -> range:
    """The longest run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], shifted, [False]]).astype(int)))
    runs = [range(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return max(runs, key=len, default=range(0))
