# SPDX-License-Identifier: Apache-2.0
"""Distortion by a lens, on the plane in front of it at unit distance, and its inverse.

Pinhole (rational model) and fisheye (Kannala and Brandt) with the coefficients in OpenCV's order:
https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html and
https://docs.opencv.org/4.x/db/d58/group__calib3d__fisheye.html. The inverses have no closed form
and are solved by Newton's method; where the polynomial has folded over they are NaN.
"""

from __future__ import annotations

import numpy as np

_ITERATIONS = 40
_TOLERANCE = 1e-12
"""Residual of an inverse, in units of the focal length."""


def distort_pinhole(plane: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """OpenCV's rational and tangential distortion on the plane z = 1, [..., 2] -> [..., 2].

    ``coefficients`` are k1 k2 p1 p2 k3 k4 k5 k6.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = plane[..., 0], plane[..., 1]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def _distortion_jacobian(plane: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Derivative of ``distort_pinhole``, [..., 2] -> [..., 2, 2]."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = plane[..., 0], plane[..., 1]
    r2 = x * x + y * y
    top, bottom = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = top / bottom
    slope = (
        k1 + r2 * (2 * k2 + 3 * k3 * r2) - radial * (k4 + r2 * (2 * k5 + 3 * k6 * r2))
    ) / bottom  # of the radial factor over r^2
    xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)


def undistort_pinhole(image: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Inverse of ``distort_pinhole`` by Newton's method, NaN where it does not converge.

    Only the branch that is connected to the image centre counts: a solution where the Jacobian has
    turned over lies beyond the fold of the polynomial, where no lens images.
    """
    if not np.any(coefficients):
        return np.array(image, dtype=np.float64)
    shape = np.shape(image)
    target = np.asarray(image, dtype=np.float64).reshape(-1, 2)
    plane = target.copy()
    scale = np.linalg.norm(target, axis=1) + 1.0
    with np.errstate(all="ignore"):
        for _ in range(_ITERATIONS):
            miss = distort_pinhole(plane, coefficients) - target
            if np.nanmax(np.linalg.norm(miss, axis=1) / scale, initial=0.0) < _TOLERANCE:
                break
            jacobian = _distortion_jacobian(plane, coefficients)
            det = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] ** 2
            step = (
                np.stack(
                    [
                        jacobian[:, 1, 1] * miss[:, 0] - jacobian[:, 0, 1] * miss[:, 1],
                        jacobian[:, 0, 0] * miss[:, 1] - jacobian[:, 0, 1] * miss[:, 0],
                    ],
                    axis=1,
                )
                / det[:, None]
            )
            # A long step near the fold would land on another branch.
            length = np.linalg.norm(step, axis=1, keepdims=True)
            plane = plane - step * np.minimum(1.0, 0.5 * scale[:, None] / np.maximum(length, 1e-30))
        miss = np.linalg.norm(distort_pinhole(plane, coefficients) - target, axis=1)
        jacobian = _distortion_jacobian(plane, coefficients)
        det = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] ** 2
        good = (miss < 1e-9 * scale) & (det > 0) & (jacobian[:, 0, 0] + jacobian[:, 1, 1] > 0)
    return np.where(good[:, None], plane, np.nan).reshape(shape)


def fisheye_radius(theta: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Distance from the principal point in focal lengths of a ray ``theta`` off the axis."""
    k1, k2, k3, k4 = coefficients
    t2 = theta * theta
    return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))


def fisheye_limit(coefficients: np.ndarray) -> float:
    """Angle off the axis up to which the fisheye polynomial rises, at most pi."""
    k1, k2, k3, k4 = coefficients
    roots = np.roots([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0])
    real = roots[np.abs(roots.imag) < 1e-9].real
    folds = np.sqrt(real[real > 0])
    return float(min(np.pi, folds.min(initial=np.pi)))


def invert_fisheye(bent: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Angle off the axis of a radius, by Newton's method kept inside a bracket."""
    limit = fisheye_limit(coefficients)
    k1, k2, k3, k4 = coefficients
    low, high = np.zeros_like(bent), np.full_like(bent, limit)
    theta = np.clip(bent, 0.0, limit)
    for _ in range(_ITERATIONS):
        t2 = theta * theta
        miss = fisheye_radius(theta, coefficients) - bent
        low, high = np.where(miss < 0, theta, low), np.where(miss >= 0, theta, high)
        slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        with np.errstate(divide="ignore", invalid="ignore"):
            new = theta - miss / slope
        inside = (new >= low) & (new <= high)
        new = np.where(inside, new, 0.5 * (low + high))
        moved = np.abs(new - theta).max(initial=0.0)
        theta = new
        if moved < _TOLERANCE:
            break
    miss = np.abs(fisheye_radius(theta, coefficients) - bent)
    return np.where(miss < 1e-9 * (1 + bent), theta, np.nan)
