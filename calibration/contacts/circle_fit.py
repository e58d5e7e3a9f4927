# SPDX-License-Identifier: Apache-2.0
"""Robust circle through edge points: RANSAC, then least squares on its inliers.

The least-squares step is Kasa's algebraic fit (I. Kasa, IEEE Trans. Instrum. Meas. 25, 1976),
which is unbiased enough here since the inliers go nearly all the way round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RANSAC_TRIALS = 200


@dataclass(frozen=True)
class CircleFit:
    """A circle and how well points agree with it."""

    center: np.ndarray
    """(x, y), shape [2]."""
    radius: float
    inliers: np.ndarray
    """Points within the tolerance, bool, shape [point_count]."""
    rms: float
    """Root mean square distance of the inliers from the circle."""


def fit_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre [2] and radius of the least-squares circle through points [n, 2], n >= 3."""
    # The origin is moved to the mean: the algebraic fit is badly conditioned far from it.
    mean = points.mean(axis=0)
    local = points - mean
    design = np.column_stack([local, np.ones(len(local))])
    solution, *_ = np.linalg.lstsq(design, (local**2).sum(axis=1), rcond=None)
    center = solution[:2] / 2
    radius = float(np.sqrt(max(solution[2] + center @ center, 0.0)))
    return center + mean, radius


def fit_circle_ransac(points: np.ndarray, tolerance: float, seed: int = 0) -> CircleFit:
    """Circle that most of the points [n, 2] lie on to within ``tolerance``, refined on them."""
    rng = np.random.default_rng(seed)
    best = np.zeros(len(points), dtype=bool)
    for _ in range(RANSAC_TRIALS):
        center, radius = fit_circle(points[rng.choice(len(points), 3, replace=False)])
        inliers = np.abs(np.linalg.norm(points - center, axis=1) - radius) < tolerance
        if inliers.sum() > best.sum():
            best = inliers
    for _ in range(3):
        if best.sum() < 3:
            break
        center, radius = fit_circle(points[best])
        best = np.abs(np.linalg.norm(points - center, axis=1) - radius) < tolerance
    chosen = points[best] if best.sum() >= 3 else points
    center, radius = fit_circle(chosen)
    distance = np.linalg.norm(chosen - center, axis=1) - radius
    return CircleFit(center, radius, best, float(np.sqrt(np.mean(distance**2))))
