# SPDX-License-Identifier: Apache-2.0
"""Circles through what is seen along the rays from a contact's centre, such as its rim."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

RAY_COUNT = 180


@dataclass(frozen=True)
class CircleFit:
    """A circle and how well points agree with it."""

    center: np.ndarray
    """(x, y), shape [2]."""
    radius: float
    inliers: np.ndarray
    """Points within the tolerance, bool, shape [point_count]."""


def sample_rays(image: np.ndarray, center: np.ndarray, reach_px: float) -> np.ndarray:
    """Values of an image [rows, columns(, channels)] along rays from ``center``, a pixel apart.

    Shape [180, reach + 1(, channels)]; NaN outside the image.
    """
    angle = np.arange(RAY_COUNT)[:, None] * (2 * np.pi / RAY_COUNT)
    distance = np.arange(int(np.ceil(reach_px)) + 1)[None, :]
    x = (center[0] + distance * np.cos(angle)).astype(np.float32)
    y = (center[1] + distance * np.sin(angle)).astype(np.float32)
    rays = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    outside = (x < 0) | (y < 0) | (x > image.shape[1] - 1) | (y > image.shape[0] - 1)
    rays[outside] = np.nan
    return rays


def fit_circle(
    points: np.ndarray, center: np.ndarray, radius: float, tolerance: float
) -> CircleFit:
    """Circle through points [n, 2], from one nearby; points beyond ``tolerance`` have no say.

    Distances from the circle count after Cauchy first, which finds the points that agree, and those
    alone by least squares then.
    """

    def off(circle: np.ndarray) -> np.ndarray:
        return np.hypot(*(points - circle[:2]).T) - circle[2]

    start = np.array([*center, radius])
    found = least_squares(off, start, loss="cauchy", f_scale=tolerance).x
    inliers = np.abs(off(found)) < tolerance
    for _ in range(2):
        kept = inliers if inliers.sum() >= 3 else np.ones(len(points), dtype=bool)
        found = least_squares(lambda circle, kept=kept: off(circle)[kept], found).x
        inliers = np.abs(off(found)) < tolerance
    return CircleFit(found[:2], float(found[2]), inliers)


def circle_on_rays(
    reach_px: np.ndarray, seen: np.ndarray, center: np.ndarray, radius: float
) -> CircleFit:
    """Circle through a place on each ray from ``center``; inliers are rays.

    ``reach_px`` is how far out the place lies, shape [180]; rays that are not ``seen`` (bool,
    likewise) have none.
    """
    angle = np.arange(RAY_COUNT) * (2 * np.pi / RAY_COUNT)
    points = center + reach_px[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    if seen.sum() < 3:
        seen = np.ones(RAY_COUNT, dtype=bool)
    fit = fit_circle(points[seen], center, radius, tolerance=max(2.0, 0.06 * radius))
    inliers = np.zeros(RAY_COUNT, dtype=bool)
    inliers[np.flatnonzero(seen)[fit.inliers]] = True
    return CircleFit(fit.center, fit.radius, inliers)


def fit_rim(change: np.ndarray, center: np.ndarray, radius: float) -> CircleFit:
    """Circle through the point of each ray where the colour changes fastest, near the given one.

    The lens blurs the rim, so that this circle is a little wider than the contact.
    """
    rays = sample_rays(change, center, 1.4 * radius + 4)
    speed = np.nan_to_num(np.linalg.norm(np.gradient(rays, axis=1), axis=-1), nan=0.0)
    speed[:, : int(0.75 * radius)] = 0.0
    peak = np.argmax(speed, axis=1)
    reach = peak + _parabola_offset(speed, peak)
    return circle_on_rays(reach, speed[np.arange(RAY_COUNT), peak] > 0, center, radius)


def _parabola_offset(values: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Sub-sample position of each row's peak relative to its index, within half a sample."""
    rows = np.arange(len(values))
    middle = np.clip(peak, 1, values.shape[1] - 2)
    left, top, right = (values[rows, middle + k] for k in (-1, 0, 1))
    curvature = left - 2 * top + right
    offset = np.divide(0.5 * (left - right), curvature, out=np.zeros_like(top), where=curvature < 0)
    return np.where(middle == peak, np.clip(offset, -0.5, 0.5), 0.0)
