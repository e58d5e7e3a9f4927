# SPDX-License-Identifier: Apache-2.0
"""How large the dots are and where they roughly lie, from the grey picture alone.

The scale-normalised Laplacian of a Gaussian answers most where its width fits a disc: at sigma =
r / sqrt(2), with 2/e of the disc's contrast (T. Lindeberg, "Feature detection with automatic scale
selection", IJCV 30, 1998). Dots are many blobs of one size, of one sign, and far stronger than
anything else of that size; a picture without dots has no such gap between strong and weak blobs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.robust_fit import spread_about_zero

MIN_SIZE_PX = 32
_FINE = 6.0
"""Width, in its own pixels, of a Gaussian that is wide enough to be sampled."""
_FLOOR = 0.08
"""Share of the picture's bright level below which the light is too weak to divide by."""
_DISC_RESPONSE = 2.0 / np.e
"""Answer of the filter of the right width to a disc of contrast one."""
_MIN_SIGMA_PX = 1.0
_LONGEST_PX = 1000
"""Larger pictures are looked at reduced; dots that then vanish are too small for their sensor."""
_RATIO = 1.2
_LARGEST = 14.0
"""The widest filter is the picture's shorter side over this; six dots in a row have to fit."""
_AROUND = 4.0
"""Neighbourhood of the local contrast, in widths of the filter."""
MIN_CONTRAST = 0.03
"""Relative contrast below which a blob is taken for shading or noise."""


@dataclass(frozen=True)
class DotScale:
    """Size and sign of the dots in a picture."""

    sigma_px: float
    """Width of the filter that fits the dots; their radius is sqrt(2) times it."""
    sign: int
    """-1 for dark dots, +1 for bright ones."""
    threshold: float
    """Contrast between the weakest dot and the strongest of what is none."""
    gap: float
    """Ratio of contrasts across that threshold: 1 for a continuum, large for clean dots."""
    count: int
    """Blobs above the threshold."""

    @property
    def radius_px(self) -> float:
        """Radius of a disc that the filter fits [px]."""
        return self.sigma_px * np.sqrt(2.0)


def grey_levels(image: np.ndarray) -> np.ndarray:
    """Mean of the channels [levels], float32, shape [height_px, width_px].

    The mean, not OpenCV's luma: paint changes all channels alike, coloured light one of them.

    Raises:
        InputError: Not an image of one or three channels of at least 32x32 px, or not finite.
    """
    array = np.asarray(image)
    if array.ndim == 3 and array.shape[2] == 3:
        grey = cv2.transform(array.astype(np.float32), np.full((1, 3), 1 / 3, np.float32))
    elif array.ndim == 2:
        grey = array.astype(np.float32)
    else:
        raise InputError(f"markers need a grey or RGB image, got an array of {array.shape}")
    if min(grey.shape) < MIN_SIZE_PX:
        raise InputError(
            f"an image of {grey.shape[1]}x{grey.shape[0]} px is too small for markers; at least "
            f"{MIN_SIZE_PX}x{MIN_SIZE_PX} px"
        )
    if not np.isfinite(grey).all():
        raise InputError("the image holds levels that are not finite")
    return grey


def bright_level(grey: np.ndarray) -> float:
    """Level that the bright part of the picture has: its 95th percentile, at least 1."""
    return max(float(np.percentile(grey, 95)), 1.0)


def local_contrast(grey: np.ndarray, around_px: float, bright: float) -> np.ndarray:
    """``grey / mean around - 1``: the same for a dot in the light and one in the shade.

    Args:
        grey: Levels, shape [height_px, width_px].
        around_px: Standard deviation of the Gaussian that takes the mean [px].
        bright: ``bright_level`` of the picture; light below 8 % of it is not divided by.
    """
    factor = max(1, int(around_px / _FINE))
    height, width = grey.shape
    # A wide mean needs no fine pixels.
    size = (max(1, width // factor), max(1, height // factor))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA) if factor > 1 else grey
    small = cv2.GaussianBlur(small, (0, 0), around_px / factor, borderType=cv2.BORDER_REPLICATE)
    around = cv2.resize(small, (width, height)) if factor > 1 else small
    return (grey - around) / np.maximum(around, _FLOOR * bright)


def reduced(grey: np.ndarray, factor: int) -> np.ndarray:
    """Means of squares of ``factor`` pixels; what is left over at the right and below is cut off.

    Pixel (u, v) of the reduced picture is the middle of its square: ``(u + 0.5) factor - 0.5``.
    """
    if factor <= 1:
        return grey
    height, width = (side // factor * factor for side in grey.shape)
    size = (width // factor, height // factor)
    return cv2.resize(grey[:height, :width], size, interpolation=cv2.INTER_AREA)


def response(grey: np.ndarray, sigma_px: float, bright: float) -> np.ndarray:
    """Contrast of a disc of radius ``sqrt(2) sigma_px`` at each pixel, dark ones negative.

    Beyond the border the light goes on as it falls there (odd reflection): a mirrored or held
    picture has a kink where the light has a slope, and a kink answers like a dot.
    """
    margin = min(int(np.ceil(4.0 * sigma_px)) + 2, min(grey.shape) - 1)
    wide = np.pad(grey, margin, mode="reflect", reflect_type="odd")
    contrast = local_contrast(wide, _AROUND * sigma_px, bright)
    smooth = cv2.GaussianBlur(contrast, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
    laplacian = cv2.Laplacian(smooth, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REPLICATE)
    inner = laplacian[margin:-margin, margin:-margin]
    return -inner * np.float32(sigma_px**2 / _DISC_RESPONSE)


def find_blobs(
    answer: np.ndarray, sigma_px: float, sign: int, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """Local extrema of ``response`` of one sign, at least ``least`` strong, strongest first.

    Returns:
        Whole pixels (u, v), shape [blob, 2], and the contrast that a disc of the filter's width
        would have, positive, shape [blob].
    """
    signed = sign * answer
    # A square: its maximum filter is separable.
    width = 2 * max(1, round(sigma_px)) + 1
    kernel = np.ones((width, width), dtype=np.uint8)
    peak = (signed >= cv2.dilate(signed, kernel)) & (signed >= least)
    # Equal neighbours make one blob.
    count, _, _, centres = cv2.connectedComponentsWithStats(peak.astype(np.uint8))
    if count < 2:
        return np.empty((0, 2)), np.empty(0)
    uv = np.rint(centres[1:]).astype(int)
    strength = signed[uv[:, 1], uv[:, 0]]
    # The middle of a bent plateau may lie beside it.
    uv, strength = uv[strength >= least], strength[strength >= least]
    order = np.argsort(-strength)
    return uv[order].astype(np.float64), strength[order].astype(np.float64)


def _split_by_gap(contrast: np.ndarray) -> tuple[int, float]:
    """Where strengths, sorted downwards, split best into dots and the rest.

    Returns:
        Number above the split, and the ratio of contrasts across it. Of all splits that keep a
        range of at most eight in strength above it, the widest gap that leaves at least six; a
        strong few (a glint, a label) over many alike must not win, so that gaps count by the
        square root of the number above them.
    """
    if len(contrast) < 7:  # six dots and what is none
        return len(contrast), 1.0
    ratio = contrast[:-1] / np.maximum(contrast[1:], 1e-9)
    above = np.arange(1, len(contrast))
    middle = 0.5 * (contrast[(above - 1) // 2] + contrast[above // 2])
    allowed = (above >= 6) & (contrast[:-1] > middle / 8) & (contrast[1:] < 0.75 * middle)
    if not allowed.any():
        return len(contrast), 1.0
    score = np.where(allowed, np.log(ratio) * np.sqrt(above), -np.inf)
    best = int(np.argmax(score))
    return best + 1, float(ratio[best])


def scale_candidates(image: np.ndarray) -> list[DotScale]:
    """Sizes and signs that blobs in a picture have, most dot-like first.

    Of every width and sign, the blobs that are extrema across widths too are counted; neighbouring
    widths are taken together, as dots in one picture differ a little in size.
    """
    grey = grey_levels(image)
    factor = -(-max(grey.shape) // _LONGEST_PX)
    grey = reduced(grey, factor)
    bright = bright_level(grey)
    steps = np.log(min(grey.shape) / _LARGEST / _MIN_SIGMA_PX) / np.log(_RATIO)
    sigmas = _MIN_SIGMA_PX * _RATIO ** np.arange(-1, max(3, int(steps) + 1))
    answers = np.stack([response(grey, float(sigma), bright) for sigma in sigmas])
    noises = [spread_about_zero(answer) for answer in answers]
    found = []
    for sign in (-1, 1):
        weight = _weight_by_scale(answers, noises, sigmas, sign)
        for k in _peaks(weight)[:3]:
            scale = _describe_scale(answers[k], noises[k], float(sigmas[k]), sign)
            found.append((weight[k], scale))
    found.sort(key=lambda item: -item[0])
    return [replace(s, sigma_px=factor * s.sigma_px) for _, s in found if s.count > 0]


def _describe_scale(answer: np.ndarray, noise: float, sigma_px: float, sign: int) -> DotScale:
    """Dots of a known size and sign: how many stand out, and by how much."""
    least = max(MIN_CONTRAST, 1.5 * noise)
    uv, contrast = find_blobs(answer, sigma_px, sign, least)
    # At the border a part of a dot, or the end of the light, answers as it likes.
    contrast = contrast[is_inside(uv, answer.shape, 1.5 * sigma_px)]
    count, gap = _split_by_gap(contrast)
    if count == 0:
        return DotScale(sigma_px, sign, least, 1.0, 0)
    strongest_other = contrast[count] if count < len(contrast) else least
    threshold = float(np.sqrt(contrast[count - 1] * strongest_other))
    if count == len(contrast):
        gap = float(contrast[count - 1] / least)
    return DotScale(sigma_px, sign, threshold, gap, count)


def _weight_by_scale(
    answers: np.ndarray, noises: list[float], sigmas: np.ndarray, sign: int
) -> np.ndarray:
    """How much of the picture the blobs that are extrema at each width explain, shape [width].

    Squared contrast times area: the rims of large dots are many small blobs of little area.
    """
    weight = np.zeros(len(sigmas))
    for k in range(1, len(sigmas) - 1):
        sigma = sigmas[k]
        uv, _ = find_blobs(answers[k], float(sigma), sign, max(MIN_CONTRAST, 3.0 * noises[k]))
        at = uv[is_inside(uv, answers[k].shape, 1.5 * float(sigma))].astype(int)
        signed = sign * answers[:, at[:, 1], at[:, 0]]
        extremum = np.all([signed[k] >= signed[j] for j in (k - 1, k + 1)], axis=0)
        strong = np.minimum(signed[k][extremum], 1.0)
        weight[k] = float((strong**2).sum() * sigma**2)
    smooth = weight.copy()
    smooth[1:] += 0.5 * weight[:-1]
    smooth[:-1] += 0.5 * weight[1:]
    return smooth


def is_inside(at: np.ndarray, shape: tuple[int, ...], margin: float) -> np.ndarray:
    """Pixels (u, v) at least ``margin`` from the border."""
    height, width = shape
    u, v = at[:, 0], at[:, 1]
    return (u >= margin) & (v >= margin) & (u < width - margin) & (v < height - margin)


def _peaks(weight: np.ndarray) -> list[int]:
    padded = np.concatenate([[0.0], weight, [0.0]])
    peak = (weight >= padded[:-2]) & (weight >= padded[2:]) & (weight > 0)
    return sorted(np.flatnonzero(peak).tolist(), key=lambda k: -weight[k])
