# SPDX-License-Identifier: Apache-2.0
"""What a detector finds of a calibration board in one image, and which point of the board is which.

Many points may be none of the board. The numbering is grown as for markers. What a board adds is
its known number of columns and rows: its points are the fullest window of that size, among
strangers that may outnumber them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from taccel_lab.calibration.capture.captures import Frame
from taccel_lab.reading.dots.lattice_growth import (
    FLIPS,
    TURNS,
    largest_growth,
    mean_steps,
    shortest_basis,
    turned_to_image,
)


@dataclass(frozen=True)
class BoardView:
    """Points of one board in one image; the board's x and y run as the image's do, unmirrored."""

    name: str
    source: str
    """File the image comes from, for error messages."""
    size_px: tuple[int, int]
    """Width and height of the image."""
    index: np.ndarray
    """Column and row of each point on the board, int, shape [n, 2]."""
    uv_px: np.ndarray
    """Where it is seen, shape [n, 2]; pixel (0, 0) is the centre of the top left pixel."""
    expected: int
    """Points that the whole board has."""
    sha256: str = ""
    place: int | None = None
    """Which image of the manifest's boards it is, also counting those in which none is found; what
    is held out goes by it."""
    pitch_mm: float | None = None
    """Distance of neighbouring points, where it is known."""
    others_uv_px: tuple[np.ndarray, ...] = ()
    """Where other pictures of the same dents, or the same ones through other filters, show the
    points, each [n, 2]; what they differ by is the detector's own error."""

    def board_mm(self) -> np.ndarray:
        """Points on the board [mm], z = 0, shape [n, 3]; in units of the pitch without one."""
        pitch = 1.0 if self.pitch_mm is None else self.pitch_mm
        return np.column_stack([self.index * pitch, np.zeros(len(self.index))]).astype(np.float64)


def hashes_by_name(images: Sequence[BoardView | Frame]) -> dict[str, str]:
    """SHA-256 of each image by its name, with its folder where two are named alike."""
    names = Counter(image.name for image in images)
    return {
        image.name
        if names[image.name] == 1
        else "/".join(Path(image.source).parts[-2:]): image.sha256
        for image in images
        if image.sha256
    }


_BASES = (
    [[1, 0], [0, 1]],
    [[1, 1], [0, 1]],
    [[1, 0], [1, 1]],
    [[1, -1], [0, 1]],
    [[1, 0], [-1, 1]],
)
"""Changes of basis tried, for views so oblique that a diagonal is the shortest step."""


@dataclass(frozen=True)
class BoardLattice:
    """Points of a board."""

    points: np.ndarray
    """Which of the points they are, int, shape [n]."""
    index: np.ndarray
    """Column and row of each, int, shape [n, 2]."""
    irregularity: float
    """Root mean square error, in pitches, of predicting a point from the points around it."""
    strangers: int
    """Points in whole rows and columns beyond the board's size."""


def board_lattice(uv_px: np.ndarray, columns: int, rows: int) -> BoardLattice | None:
    """The largest lattice of at most ``columns`` x ``rows`` (or turned) among points [n, 2].

    Points may be missing and others be no part of it. None when no seed grows to four points that
    span the plane.
    """
    uv, asked = np.asarray(uv_px, dtype=np.float64), (columns, rows)
    grown = largest_growth(uv) if len(uv) >= 5 else None
    if grown is None or grown.count < 4 or not grown.spans_the_plane:
        return None
    points = np.flatnonzero(grown.numbered)
    keys = grown.index[points]
    # A seed's steps may be a diagonal and more; the board's sides are the shortest ones, or seen
    # from aslant nearly so.
    keys = np.rint(keys @ np.linalg.inv(shortest_basis(mean_steps(keys, uv[points]))[0])).astype(
        int
    )
    best, most = (keys, asked), -1
    for basis in _BASES:
        for size in (asked, (rows, columns)):
            index = _from_window(keys @ np.array(basis), size)
            if (inside := int(_inside(index, size).sum())) > most:
                best, most = (index, size), inside
    index, size = best
    inside = _inside(index, size)
    strangers = _whole_lines(index[~inside], *size)
    kept, at = points[inside], index[inside]
    at = oriented(at if size == asked else at[:, ::-1], uv[kept], columns == rows)
    errors = grown.errors()[kept]
    return BoardLattice(kept, at, float(np.sqrt(np.nanmean(errors**2))), strangers)


def oriented(index: np.ndarray, uv_px: np.ndarray, square: bool) -> np.ndarray:
    """Lattice indices [n, 2], from 0, whose x to y turns as in the image, since what looks at the
    front of a board sees it so, and whose columns run to the right as far as they can.

    By flips and half turns, or quarter turns for a ``square`` board.
    """
    change = turned_to_image(mean_steps(index, uv_px), TURNS if square else FLIPS)
    index = np.rint(index @ np.linalg.inv(change)).astype(np.int64)
    return index - index.min(axis=0)


def _inside(index: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return np.asarray(((index >= 0) & (index < size)).all(axis=1))


def _from_window(index: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Indices counted from the lowest site of the window of a size that holds most points."""
    index = index - index.min(axis=0)
    counts = np.zeros(np.maximum(index.max(axis=0) + 1, size), dtype=int)
    np.add.at(counts, tuple(index.T), 1)
    held = sliding_window_view(counts, size).sum(axis=(2, 3))
    return index - np.unravel_index(held.argmax(), held.shape)


def _whole_lines(outside: np.ndarray, wide: int, high: int) -> int:
    """Points in rows or columns beyond the window that are more than half full.

    Single strangers at a lattice site are dirt; a line of them means that the board is larger.
    """
    count = 0
    for axis, length in ((0, high), (1, wide)):
        for line in (-1, (wide, high)[axis]):
            beside = (outside[:, axis] == line) & (outside[:, 1 - axis] >= 0)
            beside &= outside[:, 1 - axis] < length
            if beside.sum() > 0.6 * length:
                count += int(beside.sum())
    return count
