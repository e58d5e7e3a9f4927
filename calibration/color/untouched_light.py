# SPDX-License-Identifier: Apache-2.0
"""The light of a frame by its pixels far from the contact, which no score of the contact reaches.

Far is beyond 3 contact radii. On a small picture, or under a large ball, that leaves little or
nothing; the farthest tenth of the picture is taken then, which is as far as it goes. On crops of
frames with automatic white balance (``fots_calib``) in which contacts have a quarter of the
height, lights by that tenth are off by 2.3 levels of those by the whole frame, where the frames
themselves are by 6.9; by a fifth and by three tenths they are off by 2.8 and 3.2, and by the whole
crop, contact included, by 4.3.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.color.evaluate import crop_slices
from taccel_lab.calibration.light.drift_choice import DriftChoice, DriftMode
from taccel_lab.calibration.light.fit import enough_pixels, fit_light
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

FAR_RADII = 3.0
"""Beyond this many contact radii an image is taken as untouched."""
NEAREST_RADII = 2.0
"""But none nearer than this many contact radii."""


def fit_untouched_light(
    frame: np.ndarray,
    background: np.ndarray,
    circle: ContactCircle,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
) -> LightDrift:
    """Gain and offset of ``frame`` against ``background`` on the ``far_pixels`` of its contact.

    Images are RGB levels, shape [height_px, width_px, 3]; masked pixels are left out. Raises
    InputError when the contact leaves too few pixels.
    """
    reason = too_little_left(circle, grid, mask)
    if reason:
        raise InputError(reason)
    return fit_light(frame, background, far_pixels(circle, grid, mask), gradient=False)


def choose_drift(
    frames: Iterable[tuple[np.ndarray, ContactCircle]],
    background: np.ndarray,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
    mode: DriftMode = "auto",
) -> DriftChoice:
    """Whether the light of frames, images with their contacts, is brought to the background's: by
    those that leave enough gel beside their contact to tell; where none does it is left in."""
    differences = [
        drift_by_halves(image, background, circle, grid, mask)
        for image, circle in frames
        if not too_little_left(circle, grid, mask, halves=True)
    ]
    return DriftChoice.of(differences or [(0.0, 0.0)], mode)


def drift_by_halves(
    frame: np.ndarray,
    background: np.ndarray,
    circle: ContactCircle,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
) -> tuple[float, float]:
    """Mean difference of untouched gel from the background [levels]: as captured, and in the light
    that is fitted to the other half of that gel.

    The halves lie on two sides of a line. Fitted to the very pixels that it is judged by, a light
    takes away half of the difference on a small picture even where it is no drift but a shade.
    Raises InputError when the contact leaves too few pixels.
    """
    reason = too_little_left(circle, grid, mask, halves=True)
    if reason:
        raise InputError(reason)
    captured = corrected = 0.0
    halves = _halves(far_pixels(circle, grid, mask))
    for fitted, judged in (halves, halves[::-1]):
        light = fit_light(frame, background, fitted, gradient=False)
        captured += 0.5 * _difference(frame[judged], background[judged])
        corrected += 0.5 * _difference(light.remove(frame[judged]), background[judged])
    return captured, corrected


def noise_floor_l1(
    frame: np.ndarray, background: np.ndarray, circle: ContactCircle, grid: PixelGrid
) -> float:
    """Mean absolute difference of a frame from the background far from its contact [levels].

    Raises InputError when the contact leaves nothing.
    """
    far = far_pixels(circle, grid)
    if not far.any():
        raise InputError(_too_little(far))
    return _difference(frame[far], background[far])


def too_little_left(
    circle: ContactCircle,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
    *,
    halves: bool = False,
) -> str:
    """Why the light beside a contact cannot be fitted, or not by each of two ``halves`` of the gel
    there; empty where it can."""
    far = far_pixels(circle, grid, mask)
    parts = _halves(far) if halves and far.any() else (far,)
    return "" if all(enough_pixels(part) for part in parts) else _too_little(far)


def far_pixels(
    circle: ContactCircle, grid: PixelGrid, mask: np.ndarray | None = None
) -> np.ndarray:
    """Usable pixels beyond 3 contact radii, or the farthest tenth of all where that are more, as
    far as they lie beyond 2 radii and outside the crop that scores are taken in; bool, shape
    [height_px, width_px]."""
    far = circle.far(grid, FAR_RADII, mask)
    far = far & (circle.distance_px(grid) > NEAREST_RADII * circle.radius_px)
    far[crop_slices(circle, grid)] = False
    return far


def _halves(far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pixels on both sides of the line that cuts them across where they reach farthest."""
    v, u = np.nonzero(far)
    place = np.stack([u - u.mean(), v - v.mean()])
    along = np.linalg.eigh(place @ place.T)[1][:, 1] @ place
    first = np.zeros_like(far)
    first[v, u] = along <= np.median(along)
    return first, far & ~first


def _too_little(far: np.ndarray) -> str:
    return (
        f"its contact leaves {int(far.sum())} usable pixels beyond {NEAREST_RADII:g} radii, too "
        "few to tell the light of the frame"
    )


def _difference(image: np.ndarray, background: np.ndarray) -> float:
    return float(np.abs(image.astype(np.float64) - background).mean())
