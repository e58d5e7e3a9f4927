# SPDX-License-Identifier: Apache-2.0
"""Boards of dots: printed ones that the camera sees, or pressed ones that show as a difference.

Blobs are looked for at every size and of either sign; the size at which they make the largest
lattice is taken, so that neither the dots' radius nor their brightness has to be known.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.dots.blobs import find_blobs, response
from taccel_lab.calibration.dots.board_lattice import board_lattice
from taccel_lab.calibration.dots.lattice import Lattice
from taccel_lab.errors import InputError

MIN_SHARE = 0.4
"""Least share of the dots that must be found."""
MIN_POINTS = 9
MIN_CHANGE_LEVELS = 1.0
"""Least 99th percentile of the change that counts as a press [levels of 255]."""
_GREY = 128.0
_SMALLEST_PX = 1.5
"""Width of the narrowest filter."""
_SCALES_PER_OCTAVE = 3
_CANDIDATES = 3
"""Blobs considered, as a multiple of the dots on the board."""
_TRIES = 12
"""Sizes and signs of blobs that are searched for a lattice, the strongest first."""


_IRREGULAR = 0.09
"""Largest error of a lattice's points in pitches; among random ones it is 0.12 and more."""
_RIVAL = 0.4
"""Blobs weaker than this share of those that form a lattice are no rivals to them."""


@dataclass(frozen=True)
class _Candidate:
    """Blobs of one size and sign."""

    uv_px: np.ndarray
    strength: float
    sign: int


@dataclass(frozen=True)
class _Found:
    lattice: Lattice
    uv_px: np.ndarray

    @property
    def score(self) -> float:
        return self.lattice.count - self.lattice.strangers - 10 * self.lattice.irregularity


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
    signals = _signals(image, reference, name)
    expected = columns * rows
    height, width = image.shape[:2]
    largest = min(height, width) / (2.0 * min(columns, rows))
    sigmas = _SMALLEST_PX * 2.0 ** (np.arange(0, 24) / _SCALES_PER_OCTAVE)
    best: _Found | None = None
    candidates = [
        item
        for signal in signals
        for sigma in sigmas[sigmas <= max(largest, 2.0)]
        for item in _blobs_at(signal, float(sigma), expected)
    ]
    candidates.sort(key=lambda item: -item.strength)
    least = max(MIN_POINTS, MIN_SHARE * expected)
    leader: _Candidate | None = None
    for item in candidates[:_TRIES]:
        # What is left between dots forms a lattice too, a weaker one of the other sign.
        if leader is not None and (
            item.sign != leader.sign or item.strength < _RIVAL * leader.strength
        ):
            continue
        lattice = board_lattice(item.uv_px, columns, rows)
        if lattice is None or lattice.irregularity > _IRREGULAR:
            continue
        found = _Found(lattice, item.uv_px)
        best = found if best is None or found.score > best.score else best
        if leader is None and lattice.count >= least:
            leader = item
        if lattice.count == expected and not lattice.strangers:
            break
    return _checked(best, columns, rows, expected, (width, height), name)


def detect_pins(
    image: np.ndarray,
    columns: int,
    rows: int,
    *,
    reference: np.ndarray | None,
    name: str = "image",
) -> BoardView:
    """Find a pressed board of ``columns`` x ``rows`` pins or holes; as ``detect_dots``.

    Raises:
        InputError: No ``reference`` of the untouched gel, no press, or too few dents on a lattice.
    """
    if reference is None:
        raise InputError(
            f"{name}: a pressed board shows only against an image of the untouched gel; give "
            'reference = "..." for this board, or background = "..." for the folder'
        )
    if reference.shape == image.shape:
        change = np.abs(np.asarray(image, dtype=np.float32) - reference)
        change = np.abs(change - np.median(change, axis=(0, 1))).max(axis=2)
        strongest = float(np.percentile(change, 99))
        if strongest < MIN_CHANGE_LEVELS:
            raise InputError(
                f"{name}: nothing is pressed into the gel; the strongest change against the "
                f"reference is {strongest:.2f} levels of 255, at least {MIN_CHANGE_LEVELS:g}"
            )
    return detect_dots(image, columns, rows, reference=reference, name=name)


def _checked(
    best: _Found | None,
    columns: int,
    rows: int,
    expected: int,
    size_px: tuple[int, int],
    name: str,
) -> BoardView:
    count = 0 if best is None else best.lattice.count
    if best is None or count < max(MIN_POINTS, MIN_SHARE * expected):
        raise InputError(
            f"{name}: found {count} of {expected} dots of the {columns} x {rows} board on a "
            f"lattice, at least {int(np.ceil(max(MIN_POINTS, MIN_SHARE * expected)))} are needed; "
            "check columns and rows, focus and light, or give a reference image without the board"
        )
    if best.lattice.strangers > max(2, 0.1 * count):
        raise InputError(
            f"{name}: the dots go on beyond {columns} x {rows}: {count + best.lattice.strangers} "
            f"lie on one lattice, {expected} are allowed; check columns and rows"
        )
    uv = best.uv_px[best.lattice.points]
    index = best.lattice.index
    span = np.ptp(index, axis=0) + 1
    if min(span) < 3:
        raise InputError(
            f"{name}: the {count} dots found span {span[0]} x {span[1]} sites; at least 3 x 3"
        )
    return BoardView(name, name, size_px, index, uv, expected)


def _signals(image: np.ndarray, reference: np.ndarray | None, name: str) -> list[np.ndarray]:
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


def _blobs_at(signal: np.ndarray, sigma_px: float, expected: int) -> list[_Candidate]:
    """Dark and bright blobs of one size; large ones are looked for in a smaller picture."""
    shrink = 1
    while sigma_px / shrink > 2 * _SMALLEST_PX:
        shrink *= 2
    if shrink > 1:
        size = (signal.shape[1] // shrink, signal.shape[0] // shrink)
        signal = cv2.resize(
            signal[: size[1] * shrink, : size[0] * shrink], size, interpolation=cv2.INTER_AREA
        )
    sigma = sigma_px / shrink
    answer = response(signal, sigma, max(float(np.percentile(signal, 95)), 1.0))
    found = []
    for sign in (-1, 1):
        blobs = find_blobs(answer, sigma, sign, 1e-3)
        if len(blobs.contrast) < MIN_POINTS:
            continue
        top = blobs.contrast[: max(min(expected, len(blobs.contrast)) // 2, 1)]
        keep = blobs.contrast >= 0.25 * float(np.median(top))
        keep &= np.arange(len(blobs.contrast)) < _CANDIDATES * expected
        strength = float(np.mean(top)) * min(1.0, len(blobs.contrast) / expected)
        uv = subpixel_peaks(sign * answer, blobs.uv_px[keep])
        found.append(_Candidate((uv + 0.5) * shrink - 0.5, strength, sign))
    return found


def subpixel_peaks(answer: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
    """Maxima of a smooth picture near whole pixels [n, 2], by a quadratic through 3x3 pixels."""
    height, width = answer.shape
    u = np.clip(np.rint(uv_px[:, 0]).astype(int), 1, width - 2)
    v = np.clip(np.rint(uv_px[:, 1]).astype(int), 1, height - 2)
    a = {(i, j): answer[v + j, u + i].astype(np.float64) for i in (-1, 0, 1) for j in (-1, 0, 1)}
    gu, gv = (a[1, 0] - a[-1, 0]) / 2, (a[0, 1] - a[0, -1]) / 2
    huu, hvv = a[1, 0] - 2 * a[0, 0] + a[-1, 0], a[0, 1] - 2 * a[0, 0] + a[0, -1]
    huv = (a[1, 1] - a[1, -1] - a[-1, 1] + a[-1, -1]) / 4
    det = huu * hvv - huv**2
    safe = np.where(np.abs(det) > 1e-18, det, np.inf)
    du = np.clip(-(hvv * gu - huv * gv) / safe, -1, 1)
    dv = np.clip(-(huu * gv - huv * gu) / safe, -1, 1)
    return np.column_stack([u + du, v + dv])
