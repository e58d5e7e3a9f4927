# SPDX-License-Identifier: Apache-2.0
"""Frames that did not come whole from their camera: rows were lost, or are of another frame.

A camera sends rows. Rows that it lost are filled by whoever decodes them, with one colour or with
copies of the row before: no camera's rows are alike to the level over the whole width. Rows of the
frame before, or moved sideways, leave a seam: the change against the untouched gel jumps from one
row to the next, and nowhere beside it. The lens blurs whatever touches the gel over several rows,
so that of real presses no seam is as sharp over as many columns. What a reading would take for a
touch is that jump; where it is too small to be seen, so is its effect.

Images whose camera is turned have columns for rows, and an image that is moved sideways and wrapped
round has a seam between columns: both are looked for along both axes, but seams over a part of the
width along rows alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.reading.thumb import resized

ALIKE_LEVELS = 1.0
"""Two rows that differ by no more than this anywhere are copies; an encoder may round."""
LEAST_RUN_SHARE = 1 / 60
"""Fewest rows that a camera loses, as a part of the image: a row of blocks of its encoder."""
KNOWN_RANGE_LEVELS = 3.0
"""Range that the background has over these rows, in most columns: where it is as even itself, rows
that are alike say nothing."""
CODED_PX, CODED_SHARE = 8, 0.1
"""Where so large a part of an encoder's blocks has rows that are the same, one row of such blocks,
or two, is how coarsely the image was coded, and nothing that was lost. JPEG of quality 30 has 0.2
to 0.6, of 60 0.03 to 0.4, of 95 and cameras 0 to 0.02; a compressed video 0.2."""
ACROSS = 128
"""Places along a row that seams are looked for in, means of its pixels."""
SEAM_LEVELS, SEAM_TIMES = 5.0, 3.0
"""A seam jumps by so many levels (over the channels, root of the sum of squares) in a column, and
so many times as far as any row within two beside it does."""
SEAM_SHARE, SEAM_FILLED = 0.16, 0.85
"""Part of the width that a seam has at least, and part of its columns that show it. Of 500 presses
of thirteen sensors none has more than 0.6; of those cut off at the middle of their contact 0.85 and
more, but for the faintest."""
WIDE_LEVELS, WIDE_TIMES = 1.5, 2.5
"""Likewise, of the median over the whole width: presses have up to 2.2 times where the jump has
``WIDE_LEVELS``, rows moved sideways by 20 px 3.5 times and more."""
WIDE_FREE = 0.45
"""Part of the places that may lie free of such a seam."""
ROUNDED_LEVELS = 0.8
"""Jumps that rounding to whole levels makes of a smooth image: half a level in each channel."""
SMOOTH_ACROSS = 21
"""Places along a row over which jumps are averaged for that."""
NEAR = (1, 2, 3, 8, 16, 24, 32)
"""Rows beside a seam over the whole width that have less of it: the next ones, and those at which
an encoder of video has the borders of its blocks, which are seams, too, but all of them."""
LESS = 0.5
"""Part of the difference from the untouched gel that is left of rows that are moved sideways, once
they are moved back."""

Fault = Literal["lost_rows", "torn", "shift"]
Axis = Literal["rows", "columns"]
AXES: tuple[Axis, Axis] = ("rows", "columns")
PLACES: dict[Axis, int] = {"rows": ACROSS, "columns": SMOOTH_ACROSS}
"""Places along them at which seams are looked for. A tool's straight edge may lie along columns,
and be sharp in a drawn image: seams over a part of the width are looked for along rows alone."""
EVEN = "are of one colour"
AGAIN = (
    "take the frame again; where it happens often, a shorter cable, another USB port or fewer "
    "pixels help"
)


@dataclass(frozen=True)
class BrokenFrame:
    """Part of a frame that is not what the camera saw."""

    kind: Fault
    axis: Axis
    first: int
    last: int
    """Rows (or columns) concerned, both among them."""
    why: str
    """Clause about them, to go on "rows 3 to 5" with."""

    def __str__(self) -> str:
        """What is wrong and what to do, to follow the frame's name."""
        return f"is not whole: {self.axis} {self.first} to {self.last} {self.why}; {AGAIN}"


class BrokenFrameError(InputError):
    """A frame that did not come whole from its camera."""


def require_whole(
    image: np.ndarray, untouched: np.ndarray, mask: np.ndarray | None = None, name: str = "image"
) -> None:
    """BrokenFrameError that names ``name`` for a broken frame; arguments as of ``broken_frame``."""
    found = broken_frame(image, untouched, mask)
    if found is not None:
        raise BrokenFrameError(f"{name}: it {found}")


def broken_frame(
    image: np.ndarray, untouched: np.ndarray, mask: np.ndarray | None = None
) -> BrokenFrame | None:
    """The part of a frame that is broken; None of a whole one.

    Args:
        image: Levels, shape [height_px, width_px, channel].
        untouched: The sensor's untouched image, likewise; its light may differ.
        mask: Pixels that count, bool, shape [height_px, width_px].
    """
    return lost_rows(image, untouched, mask) or Seams(untouched).torn(image, mask)


def lost_rows(
    image: np.ndarray, untouched: np.ndarray, mask: np.ndarray | None = None
) -> BrokenFrame | None:
    """The longest run of rows, or of columns, that are copies of one another where the untouched
    gel's are not; arguments as of ``broken_frame``. None of an image that is of one colour."""
    seen = _Seen(image, untouched, mask, "rows")
    return _lost(seen) or _lost(seen.turned())


class Seams:
    """Looks for seams in frames of one sensor; the untouched image's side is made once."""

    def __init__(self, untouched: np.ndarray) -> None:
        """``untouched``: levels, shape [height_px, width_px, channel]."""
        self._untouched = untouched.astype(np.float32)
        self._known = {axis: _narrow(self._untouched, axis, PLACES[axis]) for axis in AXES}

    def torn(self, image: np.ndarray, mask: np.ndarray | None = None) -> BrokenFrame | None:
        """The rows, or columns, beyond a seam, or the whole of a frame that is moved along its rows
        and wrapped round; arguments as of ``broken_frame``."""
        levels = np.asarray(image, np.float32)
        # Rows that are moved have a seam across them, too, where they are wrapped round.
        (rows_at, rows_share), (at, share) = (self._seam(levels, mask, axis) for axis in AXES)
        seen = _Seen(image, self._untouched, mask, "rows")
        if rows_share >= share:
            return _beyond(seen, rows_at) if rows_share else None
        height, width = image.shape[:2]
        if at == _sideways(seen) % width:
            why = f"lie {min(at, width - at)} px along them from where they should, wrapped round"
            return BrokenFrame("shift", "rows", 0, height - 1, why)
        return _beyond(seen.turned(), at)

    def _seam(self, levels: np.ndarray, mask: np.ndarray | None, axis: Axis) -> tuple[int, float]:
        """The row, or column, behind the clearest seam, and the part of it that shows the seam; 0
        without one."""
        jump = np.diff(_narrow(levels, axis, PLACES[axis]) - self._known[axis], axis=0)
        if mask is not None:
            kept = _narrow(mask.astype(np.float32)[..., None], axis, PLACES[axis]) > 0.999
            jump *= kept[1:] & kept[:-1]
        at = _wide_seam(_narrow(jump, "rows", SMOOTH_ACROSS))
        if at:
            return at, 1.0
        return _partial_seam(jump) if axis == "rows" else (0, 0.0)


@dataclass(frozen=True)
class _Seen:
    """A frame, the untouched gel and the pixels that count, by rows of the camera's."""

    image: np.ndarray
    untouched: np.ndarray
    mask: np.ndarray | None
    axis: Axis

    def turned(self) -> _Seen:
        """The same with columns for rows."""
        image, untouched = (np.swapaxes(each, 0, 1) for each in (self.image, self.untouched))
        return _Seen(image, untouched, None if self.mask is None else self.mask.T, "columns")

    def part(self, rows: slice) -> _Seen:
        """Some of the rows."""
        mask = None if self.mask is None else self.mask[rows]
        return _Seen(self.image[rows], self.untouched[rows], mask, self.axis)

    def change(self) -> float:
        """Mean change from the untouched gel [levels]."""
        return float(np.abs(self.image.astype(np.float32) - self.untouched).mean())

    def is_even(self) -> bool:
        """Whether it is of one colour, but for noise."""
        shown = self.image[np.ones(self.image.shape[:2], bool) if self.mask is None else self.mask]
        return bool(len(shown)) and float(shown.std(axis=0).max()) <= 2 * ALIKE_LEVELS


def _lost(seen: _Seen) -> BrokenFrame | None:
    image, untouched, mask, axis = seen.image, seen.untouched, seen.mask, seen.axis
    count = len(image)
    inside = np.ones(image.shape[:2], dtype=bool) if mask is None else mask
    # Every sixteenth column first: of whole frames hardly a row is left to look at.
    sparse = np.s_[:, ::16]
    least = max(4, round(LEAST_RUN_SHARE * count))
    runs: list[tuple[int, int, int]] = []
    for _, first, last in _runs(_copies(image[sparse], inside[sparse]), least):
        part = slice(first, last + 1)
        found = _runs(_copies(image[part], inside[part]), least)
        runs += [(length, first + start, first + end) for length, start, end in found]
    for length, first, last in sorted(runs, reverse=True):
        if length == count:
            break
        band = image[first : last + 1].astype(np.int16)
        known = np.ptp(untouched[first : last + 1].astype(np.float32), axis=0).max(axis=-1)
        apart = np.ptp(band, axis=0).max(axis=-1)
        whole = inside[first : last + 1].all(axis=0)
        if not whole.any():
            continue
        known, apart = known[whole], apart[whole]
        # Copies of copies may drift by a level a row.
        if apart.max() <= 2 * ALIKE_LEVELS and np.median(known) > KNOWN_RANGE_LEVELS:
            even = seen.part(slice(first, last + 1)).is_even()
            if not even and length <= 2 * CODED_PX and _even_blocks(image) > CODED_SHARE:
                continue
            why = EVEN if even else "are copies of one another"
            return BrokenFrame("lost_rows", axis, first, last, why)
    return None


def _even_blocks(image: np.ndarray) -> float:
    """Part of an encoder's blocks whose rows are copies of one another."""
    rows, columns = (count // CODED_PX for count in image.shape[:2])
    if not rows or not columns:
        return 0.0
    blocks = image[: rows * CODED_PX, : columns * CODED_PX].astype(np.int16)
    blocks = blocks.reshape(rows, CODED_PX, columns, -1)
    apart = np.abs(np.diff(blocks, axis=1)).max(axis=(1, 3))
    return float((apart == 0).mean())


def _runs(copied: np.ndarray, least: int) -> list[tuple[int, int, int]]:
    """Runs of at least so many rows that are copies of one another: their lengths, first and last
    rows, of those, without the first, that are copies of the one before."""
    steps = np.diff(np.concatenate([[False], copied, [False]]).astype(np.int8))
    # The first row of a run is no copy, but as good as none: what filled the others stands in it.
    starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    runs = zip((ends - starts + 1).tolist(), starts.tolist(), ends.tolist(), strict=True)
    return [run for run in runs if run[0] >= least]


def _copies(image: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Rows, without the first, that are copies of the one before, bool."""
    change = np.abs(np.diff(image.astype(np.int16, order="C"), axis=0))
    change *= (inside[1:] & inside[:-1])[..., None]
    return change.reshape(len(change), -1).max(axis=1) <= ALIKE_LEVELS


def _narrow(picture: np.ndarray, axis: Axis, places: int) -> np.ndarray:
    """Means along each row, or column, shape [row, place, channel]."""
    height, width, channels = picture.shape
    size = (min(places, width), height) if axis == "rows" else (width, min(places, height))
    small = resized(picture, size).reshape(size[1], size[0], channels)
    return small if axis == "rows" else np.ascontiguousarray(np.swapaxes(small, 0, 1))


def _beside(values: np.ndarray, away: Sequence[int]) -> np.ndarray:
    """Largest of the values so many rows before and behind, of their shape."""
    reach = min(max(away), len(values) - 1)
    padded = np.pad(values, [(reach, reach)] + [(0, 0)] * (values.ndim - 1), mode="reflect")
    both = [reach + sign * k for k in away if k <= reach for sign in (-1, 1)]
    return np.max([padded[k : k + len(values)] for k in both], axis=0)


def _lengths(jump: np.ndarray) -> np.ndarray:
    """Sizes of jumps [row, place, channel] over the channels."""
    squares = cv2.transform(np.square(jump), np.ones((1, jump.shape[-1]), np.float32))
    return np.sqrt(squares.reshape(jump.shape[:2]))


def _partial_seam(jump: np.ndarray) -> tuple[int, float]:
    """The row behind the longest sharp seam, of jumps [row, place, channel], and its part of the
    width; 0 without one."""
    size = _lengths(jump)
    width = max(4, round(SEAM_SHARE * jump.shape[1]))
    sharp = size > SEAM_LEVELS
    if np.count_nonzero(sharp, axis=1).max() <= SEAM_FILLED * width:
        return 0, 0.0
    sharp &= size > SEAM_TIMES * _beside(size, (1, 2))
    filled = cv2.blur(sharp.astype(np.float32), (width, 1), borderType=cv2.BORDER_CONSTANT)
    best = filled.max(axis=1)
    row = int(np.argmax(best))
    return (row + 1, float(sharp[row].mean())) if best[row] > SEAM_FILLED else (0, 0.0)


def _wide_seam(jump: np.ndarray) -> int:
    """The row behind a seam over the whole width, of jumps over ``SMOOTH_ACROSS`` places; 0 without
    one."""
    # A straight tool may lie over half of a view.
    size = np.sort(_lengths(jump), axis=1)[:, int(WIDE_FREE * jump.shape[1])]
    if size.max() <= WIDE_LEVELS:
        return 0
    sharp = np.where(
        size > WIDE_LEVELS, size / np.maximum(_beside(size, NEAR), ROUNDED_LEVELS), 0.0
    )
    row = int(np.argmax(sharp))
    return row + 1 if sharp[row] > WIDE_TIMES else 0


def _beyond(seen: _Seen, at: int) -> BrokenFrame:
    """The side of a seam that does not fit the untouched gel, and how far it is moved."""
    sides = [(at, len(seen.image) - 1), (0, at - 1)]
    parts = [seen.part(slice(first, last + 1)) for first, last in sides]
    for (first, last), part in zip(sides, parts, strict=True):
        px = abs(_sideways(part))
        if px:
            why = f"lie {px} px along them from where the others have the gel"
            return BrokenFrame("torn", seen.axis, first, last, why)
    # Of one colour, on a gel that is as even itself: the seam says that they are not its own.
    even = [k for k, part in enumerate(parts) if part.change() > SEAM_LEVELS and part.is_even()]
    if len(even) == 1:
        return BrokenFrame("lost_rows", seen.axis, *sides[even[0]], EVEN)
    first, last = min(sides, key=lambda side: side[1] - side[0])
    return BrokenFrame("torn", seen.axis, first, last, "are of another moment than the others")


def _sideways(seen: _Seen) -> int:
    """How far rows lie along themselves from the untouched gel's [px], wrapped round: the shift of
    least squares. 0 where they lie there, or where a shift explains too little."""
    mask = seen.mask

    def rows(picture: np.ndarray) -> np.ndarray:
        grey = picture.astype(np.float32).mean(axis=-1)
        if mask is not None:
            grey = np.where(mask, grey, grey[mask].mean() if mask.any() else np.float32(0))
        return grey - grey.mean()

    width = seen.image.shape[1]
    shown, known = rows(seen.image), rows(seen.untouched)
    together = np.fft.rfft(shown, axis=1) * np.fft.rfft(known, axis=1).conj()
    alike = np.fft.irfft(together.sum(axis=0), n=width)
    left = float(np.square(shown).sum() + np.square(known).sum()) - 2.0 * alike
    best = int(np.argmin(left))
    if left[best] > LESS * left[0]:
        return 0
    return best if best <= width // 2 else best - width
