# SPDX-License-Identifier: Apache-2.0
"""Whether the untouched gel's pattern has moved in the image since the background was taken.

Dust, scratches, dots and the gel's edge stand still until somebody puts the gel back or turns the
lens. What is smooth of both images is taken off; the peak of their normalised cross-spectrum tells
the shift (Kuglin and Hines, Proc. IEEE Conf. Cybernetics and Society, 1975, 163-165).
"""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.smoothing import smoothed

MOST_PX = 3.0
"""Shift of a picture of 480 rows that readings bear: 9 px make a contact 47 % wider."""
ROWS = 480
GRAIN_SHARE = 1 / 40
"""What is smooth over more than this part of the shorter side is light, not pattern."""
ALIKE = 0.4
"""Correlation of the patterns from which on they are the same one."""
BETTER = 0.2
"""How much better they agree shifted than as they are."""


def pattern_shift(
    image: np.ndarray, background: np.ndarray, mask: np.ndarray | None = None
) -> tuple[float, float] | None:
    """How far the pattern of ``image`` lies right of and below that of ``background`` [px]; None
    where it lies there, or where there is too little of one to tell.

    Both are RGB levels in one light, shape [height_px, width_px, 3].
    """
    import cv2

    sigma = max(GRAIN_SHARE * min(image.shape[:2]), 1.0)
    seen, known = (_grain(picture, mask, sigma) for picture in (image, background))
    window = cv2.createHanningWindow(seen.shape[::-1], cv2.CV_32F)
    (right, down), _ = cv2.phaseCorrelate(known * window, seen * window)
    if max(abs(right), abs(down)) <= MOST_PX * min(image.shape[:2]) / ROWS:
        return None
    moved = np.roll(known, (round(down), round(right)), (0, 1))
    shifted, straight = (_correlation(seen, other, sigma) for other in (moved, known))
    if shifted < ALIKE or shifted < straight + BETTER:
        return None
    return float(right), float(down)


def _grain(picture: np.ndarray, mask: np.ndarray | None, sigma: float) -> np.ndarray:
    """Fine structure of the mean of the channels [levels], float32, shape [height, width]."""
    picture = picture.astype(np.float32)
    grain = (picture - smoothed(picture, mask, sigma)).mean(axis=-1)
    return grain if mask is None else np.where(mask, grain, np.float32(0))


def _correlation(one: np.ndarray, other: np.ndarray, sigma: float) -> float:
    """Median over the picture of the correlation in a neighbourhood: a contact has no pattern of
    the background."""
    import cv2

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), 2 * sigma))

    both = mean(one * other)
    size = np.sqrt(np.maximum(mean(one * one) * mean(other * other), 1e-12))
    return float(np.median(both / size))
