# SPDX-License-Identifier: Apache-2.0
"""Stretches of a video over which nothing in the picture moves.

Motion is that of blocks of the picture: one step of Lucas and Kanade ("An iterative image
registration technique", IJCAI 1981) in each, exact for motions well below the size of a dot, which
are the ones to be distinguished from none. On the GelSight Mini video of docs/evidence/ablations.md
it agrees with the fitted dots to 0.02 px at the median and 0.05 px at the 90th percentile.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

STILL_PITCHES = 0.01
"""No block of the picture moves by more than this part of the dots' pitch."""
STILL_FRAMES = 5
STILL_SECONDS = 0.2
"""The least time, where the frame rate is known: a press that turns back stands still for less."""
_BLOCKS = (6, 8)
_LARGEST_PX = 640
"""Larger pictures are shrunk to this: a hundredth of a pitch is resolved all the same."""
_SMOOTH_PX, _WIDE_PITCHES = 1.0, 0.4
_BARE = 0.1
"""Blocks with less than this part of the usual structure say nothing of motion."""
_STRAY_BLOCKS = 1
"""Blocks that may disagree: dots that the border cuts, a glint."""
_STEADY = 0.5
"""The last third of a stretch lies at most this part of the allowed motion from its first."""


@dataclass(frozen=True)
class Stillness:
    """What of a video stands still: numbers of frames that show the same."""

    stretches: tuple[range, ...]
    """Stretches that are long enough to be believed, in order."""
    longest: range
    """The longest of all, also of those that are too short."""
    frames: int
    needed: int
    """Frames of a stretch that is long enough."""
    limit_px: float


def still_stretches(
    frames: Iterable[np.ndarray], pitch_px: float, fps: float | None = None
) -> Stillness:
    """Frames over which no block moves by more than 0.01 pitches, and which do not drift.

    Args:
        frames: RGB or grey images in order, all of one size; at least one.
        pitch_px: Distance of neighbouring dots [px].
        fps: Frames a second, where known.
    """
    limit = STILL_PITCHES * pitch_px
    needed = STILL_FRAMES if fps is None else max(STILL_FRAMES, int(np.ceil(STILL_SECONDS * fps)))
    found, longest, count = [], range(1), 0
    for run in _runs(frames, pitch_px, limit):
        if len(run.frames) >= needed and run.steady():
            found.append(run.frames)
        longest, count = max(longest, run.frames, key=len), run.frames.stop
    return Stillness(tuple(found), longest, count, needed, limit)


def _runs(frames: Iterable[np.ndarray], pitch_px: float, limit_px: float) -> Iterator[_Run]:
    run = None
    for number, frame in enumerate(frames):
        picture, shrunk = _structure(frame, pitch_px)
        if run is None or not run.goes_on(picture):
            if run is not None:
                yield run
            run = _Run(number, picture, limit_px / shrunk)
    if run is not None:
        yield run


class _Run:
    """A stretch that may go on."""

    def __init__(self, first: int, picture: np.ndarray, limit: float) -> None:
        self.frames = range(first, first + 1)
        self._first = self._last = picture
        self._limit = limit
        self._motions = [np.zeros((_BLOCKS[0] * _BLOCKS[1], 2), dtype=np.float32)]

    def goes_on(self, picture: np.ndarray) -> bool:
        """Whether the next picture shows the same as the first one and as the last one; takes it
        in where it does."""
        if picture.shape != self._last.shape:
            return False
        if _largest(_block_motion(self._last, picture)) > self._limit:
            return False
        motion = _block_motion(self._first, picture)
        if _largest(motion) > self._limit:
            return False
        self._motions.append(motion)
        self._last = picture
        self.frames = range(self.frames.start, self.frames.stop + 1)
        return True

    def steady(self) -> bool:
        """Whether its end lies where its beginning does: a slow motion is no rest."""
        third = max(1, len(self._motions) // 3)
        start, end = (
            np.mean(part, axis=0) for part in (self._motions[:third], self._motions[-third:])
        )
        return _largest(end - start) <= _STEADY * self._limit


def _structure(frame: np.ndarray, pitch_px: float) -> tuple[np.ndarray, float]:
    """What can be followed: the logarithm of the light, less its slow part, float32; and how many
    times smaller it is than the frame."""
    grey = np.asarray(frame, dtype=np.float32)
    grey = np.log1p(grey.mean(axis=-1) if grey.ndim == 3 else grey)
    shrunk = max(1.0, max(grey.shape) / _LARGEST_PX)
    if shrunk > 1.0:
        size = tuple(round(side / shrunk) for side in grey.shape[::-1])
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    fine = cv2.GaussianBlur(grey, (0, 0), _SMOOTH_PX)
    wide = max(_WIDE_PITCHES * pitch_px / shrunk, 4.0 * _SMOOTH_PX)
    return fine - cv2.GaussianBlur(fine, (0, 0), wide), shrunk


def _block_motion(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Motion of each block from ``a`` to ``b`` [px], shape [block, 2]; NaN without structure."""
    middle = 0.5 * (a + b)
    gradient = [cv2.Sobel(middle, cv2.CV_32F, dx, dy) / 8 for dx, dy in ((1, 0), (0, 1))]
    x, y, change = gradient[0], gradient[1], b - a
    sums = np.stack([_by_block(part) for part in (x * x, x * y, y * y, x * change, y * change)])
    xx, xy, yy, xt, yt = sums
    determinant = xx * yy - xy * xy
    strength = xx + yy
    bare = (strength <= _BARE * np.median(strength)) | (determinant <= 1e-6 * strength**2)
    safe = np.where(bare, 1.0, determinant)
    motion = np.stack([xy * yt - yy * xt, xy * xt - xx * yt], axis=1) / safe[:, None]
    return np.where(bare[:, None], np.nan, motion).astype(np.float32)


def _by_block(values: np.ndarray) -> np.ndarray:
    """Sums over the blocks, float64, shape [block]."""
    rows, columns = (
        np.linspace(0, size, count + 1).astype(int)[:-1]
        for size, count in zip(values.shape, _BLOCKS, strict=True)
    )
    sums = np.add.reduceat(values.astype(np.float64), rows, axis=0)
    return np.add.reduceat(sums, columns, axis=1).ravel()


def _largest(motion: np.ndarray) -> float:
    """Largest motion of all blocks but the stray ones [px]; infinite where no block says any."""
    length = np.sort(np.linalg.norm(motion, axis=1))
    length = length[np.isfinite(length)]
    return float(length[-1 - _STRAY_BLOCKS]) if len(length) > _STRAY_BLOCKS else float("inf")
