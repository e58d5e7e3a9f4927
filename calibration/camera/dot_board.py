# SPDX-License-Identifier: Apache-2.0
"""Boards of dots: printed ones that the camera sees, or pressed ones that show as a difference.

Dots are found as markers on the gel are, whatever their size and sign; what a board adds is its
known number of columns and rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import KDTree

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.board_lattice import board_lattice
from taccel_lab.calibration.dots.dot_fit import DotFit, fit_dots
from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.errors import InputError

MIN_SHARE = 0.4
"""Least share of the dots that must be found."""
MIN_POINTS = 9
_SAME_PITCHES = 0.3
"""Two pictures of a dot are this near each other at most."""
_SMOOTHED, _AROUND = (0.25, 0.5), 1.0
"""Widths of Gaussians, in radii of the dents: two that smooth, and one whose result is what a dent
stands out from."""
_GREY = 128.0
_IRREGULAR = 0.12
"""Largest error of predicting a lattice's point from its neighbours, root mean square in pitches:
0.04 to 0.10 on real boards (9DTact, Photon26), 0.13 and more among random points."""


def detect_dots(
    image: np.ndarray,
    columns: int,
    rows: int,
    *,
    reference: np.ndarray | None = None,
    name: str = "image",
) -> BoardView:
    """Find a board of ``columns`` x ``rows`` dots; some may be missing.

    Args:
        image: RGB levels, shape [height_px, width_px, 3].
        reference: The same view without the board, of the same size: what changed is looked at.

    Raises:
        InputError: Too few dots on a lattice, or more than the board has; with the numbers.
    """
    expected = columns * rows
    least = max(MIN_POINTS, int(np.ceil(MIN_SHARE * expected)))
    none = _Found(np.zeros((0, 2), dtype=int), np.zeros((0, 2)), 0)
    pictures = _pictures(image, reference, name)
    found = [_find(picture, columns, rows) or none for picture in pictures]
    best = max(found, key=lambda f: len(f.index) - f.strangers)
    index, uv, strangers = best.index, best.uv_px, best.strangers
    count = len(index)
    if count < least:
        raise InputError(
            f"{name}: found {count} of {expected} dots of the {columns} x {rows} board on a "
            f"lattice, at least {least} are needed; check columns and rows, focus and light, or "
            "give a reference image without the board"
        )
    if strangers > max(2, 0.1 * count):
        raise InputError(
            f"{name}: the dots go on beyond {columns} x {rows}: {count + strangers} lie on one "
            f"lattice, {expected} are allowed; check columns and rows"
        )
    span = np.ptp(index, axis=0) + 1
    if min(span) < 3:
        raise InputError(
            f"{name}: the {count} dots found span {span[0]} x {span[1]} sites; at least 3 x 3"
        )
    size = image.shape[1], image.shape[0]
    others = [f for f in found if f is not best]
    if reference is not None:
        seen = zip(pictures, found, strict=True)
        others += [again for picture, f in seen for again in _through_filters(picture, f)]
    places = (f.same_dots(best) for f in others)
    same = tuple(place for place in places if place is not None)
    return BoardView(name, name, size, index, uv, expected, others_uv_px=same)


@dataclass(frozen=True)
class _Found:
    """Dots of a picture on the board's lattice."""

    index: np.ndarray
    """Column and row of each, shape [n, 2]."""
    uv_px: np.ndarray
    strangers: int
    """Dots of the lattice that lie beyond the board."""
    dots: DotFit | None = None
    """The same dots as they were fitted."""

    def same_dots(self, other: _Found) -> np.ndarray | None:
        """Where this picture shows the dots of another one; None where it does not show all."""
        if not len(self.uv_px) or len(other.uv_px) < 2:
            return None
        pitch = float(np.median(KDTree(other.uv_px).query(other.uv_px, k=2)[0][:, 1]))
        distance, nearest = KDTree(self.uv_px).query(other.uv_px)
        return self.uv_px[nearest] if distance.max() < _SAME_PITCHES * pitch else None


def _find(picture: np.ndarray, columns: int, rows: int) -> _Found | None:
    try:
        dots = find_markers(picture).dots
    except InputError:
        return None
    lattice = board_lattice(dots.uv_px, columns, rows)
    if lattice is None or lattice.irregularity > _IRREGULAR:
        return None
    on_board = dots.select(lattice.points)
    return _Found(lattice.index, on_board.uv_px, lattice.strangers, on_board)


def _through_filters(picture: np.ndarray, found: _Found) -> list[_Found]:
    """The dots of a picture as filters of several widths show them. A dent's shading is no disc:
    where its centre is seen depends on the filter, alike for all dents of a side."""
    if found.dots is None:
        return []
    radius = float(np.median(found.dots.radius_px))
    smooth = [cv2.GaussianBlur(picture, (0, 0), share * radius) for share in _SMOOTHED]
    against = _GREY + picture - cv2.GaussianBlur(picture, (0, 0), _AROUND * radius)
    again = [fit_dots(filtered, found.dots.parameters) for filtered in (*smooth, against)]
    return [
        replace(found, uv_px=np.where(fit.placed[:, None], fit.uv_px, found.uv_px)) for fit in again
    ]


def _pictures(image: np.ndarray, reference: np.ndarray | None, name: str) -> list[np.ndarray]:
    """Grey pictures in which dots may stand out, float32, shape [height_px, width_px]."""
    levels = np.asarray(image, dtype=np.float32)
    if reference is None:
        return [levels.mean(axis=2)]
    if reference.shape != image.shape:
        raise InputError(
            f"{name} is {image.shape[1]}x{image.shape[0]} px but its reference is "
            f"{reference.shape[1]}x{reference.shape[0]} px; both have to be of one size"
        )
    change = levels - np.asarray(reference, dtype=np.float32)
    change -= np.median(change, axis=(0, 1))
    # A dent darkens a depth sensor and colours a photometric one, each side differently.
    return [_GREY + change.mean(axis=2), _GREY + np.linalg.norm(change, axis=2)]
