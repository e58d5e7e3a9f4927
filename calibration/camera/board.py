# SPDX-License-Identifier: Apache-2.0
"""What a detector finds of a calibration board in one image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
    first_square_dark: bool | None = None
    """Chessboards: colour of the square before column 0 and row 0, when it tells a mirrored board
    from a turned one."""

    def board_mm(self) -> np.ndarray:
        """Points on the board [mm], z = 0, shape [n, 3]; in units of the pitch without one."""
        pitch = 1.0 if self.pitch_mm is None else self.pitch_mm
        return np.column_stack([self.index * pitch, np.zeros(len(self.index))]).astype(np.float64)

    def take(self, chosen: np.ndarray) -> BoardView:
        """The view with some of its points: a mask or indices."""
        from dataclasses import replace

        return replace(self, index=self.index[chosen], uv_px=self.uv_px[chosen])


def unmirrored(index: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
    """Lattice indices [n, 2] with columns flipped where needed, so that x to y turns as in the
    image: what looks at the front of a board sees it so. Also says 0 for the least index."""
    index = np.array(index, dtype=np.int64)
    design = np.column_stack([index, np.ones(len(index))])
    slopes, *_ = np.linalg.lstsq(design, uv_px, rcond=None)
    if np.linalg.det(slopes[:2]) < 0:
        index[:, 0] = -index[:, 0]
    return index - index.min(axis=0)


def upright(index: np.ndarray, uv_px: np.ndarray, square: bool) -> np.ndarray:
    """Turn lattice indices so that columns run to the right of the image as far as they can.

    By half turns, or by quarter turns for a ``square`` board; ``unmirrored`` indices stay so.
    """
    design = np.column_stack([index, np.ones(len(index))])
    slopes, *_ = np.linalg.lstsq(design, uv_px, rcond=None)
    along = slopes[0]
    turns = round(float(np.degrees(np.arctan2(along[1], along[0]))) / 90.0) % 4
    if not square and turns % 2:
        turns = 0 if along[0] >= 0 else 2
    for _ in range(turns):
        # A column axis that points down in the image becomes the row axis.
        index = np.column_stack([-index[:, 1], index[:, 0]])
    return index - index.min(axis=0)
