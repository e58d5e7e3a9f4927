# SPDX-License-Identifier: Apache-2.0
"""Projection of a physical camera: gel points to pixels and pixels to rays, vectorised.

Pinhole (rational model) and fisheye (Kannala and Brandt) with the coefficients in OpenCV's order:
https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html and
https://docs.opencv.org/4.x/db/d58/group__calib3d__fisheye.html. Their inverses have no closed form
and are solved by Newton's method; what a lens does not image (behind the camera, or where the
distortion polynomial has folded over) is NaN.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.profile.optical_design import DesignedCamera

_ITERATIONS = 40
_TOLERANCE = 1e-12
"""Residual of an inverse, in units of the focal length."""


class CameraModel:
    """Projects points of the gel frame through one camera, and back to rays."""

    def __init__(self, camera: DesignedCamera) -> None:
        self.camera = camera
        self.gel_from_camera = camera.gel_from_camera()
        """Rotation, shape [3, 3]."""
        self.position_mm = np.array(camera.position_mm, dtype=np.float64)
        count = 4 if camera.model == "fisheye" else 8
        self._coefficients = np.zeros(count)
        self._coefficients[: len(camera.distortion)] = camera.distortion

    def project(self, points_mm: np.ndarray) -> np.ndarray:
        """Pixels (u, v) of points in air, [..., 3] -> [..., 2]; NaN where the lens sees nothing."""
        in_camera = (np.asarray(points_mm, dtype=np.float64) - self.position_mm) @ (
            self.gel_from_camera
        )
        return self.pixels_from_directions(in_camera)

    def pixels_from_directions(self, directions: np.ndarray) -> np.ndarray:
        """Pixels of directions in the camera's own frame, any length, [..., 3] -> [..., 2]."""
        directions = np.asarray(directions, dtype=np.float64)
        if self.camera.model == "fisheye":
            image = self._distort_fisheye(directions)
        else:
            z = directions[..., 2]
            with np.errstate(divide="ignore", invalid="ignore"):
                plane = directions[..., :2] / np.where(z > 0, z, np.nan)[..., None]
            image = distort_pinhole(plane, self._coefficients)
        c = self.camera
        return image * np.array([c.fx_px, c.fy_px]) + np.array([c.cx_px, c.cy_px])

    def directions_from_pixels(self, uv_px: np.ndarray) -> np.ndarray:
        """Unit directions in the camera's own frame, [..., 2] -> [..., 3]; NaN beyond the lens."""
        c = self.camera
        uv = np.asarray(uv_px, dtype=np.float64)
        image = (uv - np.array([c.cx_px, c.cy_px])) / np.array([c.fx_px, c.fy_px])
        if c.model == "fisheye":
            return self._undistort_fisheye(image)
        plane = undistort_pinhole(image, self._coefficients)
        rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def rays(self, uv_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rays that leave the camera through pixels, in the gel frame.

        Args:
            uv_px: Pixels, shape [..., 2].

        Returns:
            Centre of projection [mm], shape [3], and unit directions, shape [..., 3].
        """
        return self.position_mm, self.directions_from_pixels(uv_px) @ self.gel_from_camera.T

    def _distort_fisheye(self, directions: np.ndarray) -> np.ndarray:
        radius = np.hypot(directions[..., 0], directions[..., 1])
        theta = np.arctan2(radius, directions[..., 2])
        bent = np.where(
            theta <= fisheye_limit(self._coefficients),
            fisheye_radius(theta, self._coefficients),
            np.nan,
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(radius > 0, bent / radius, 0.0 * bent)
        return directions[..., :2] * scale[..., None]

    def _undistort_fisheye(self, image: np.ndarray) -> np.ndarray:
        bent = np.linalg.norm(image, axis=-1)
        theta = _invert_fisheye(bent, self._coefficients)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(bent > 0, np.sin(theta) / bent, 1.0)
        return np.concatenate([image * scale[..., None], np.cos(theta)[..., None]], axis=-1)


def resized(camera: DesignedCamera, width_px: int, height_px: int) -> DesignedCamera:
    """The same camera with its image scaled to another size; pixel centres are whole numbers."""
    sx, sy = width_px / camera.width_px, height_px / camera.height_px
    return replace(
        camera,
        width_px=width_px,
        height_px=height_px,
        fx_px=camera.fx_px * sx,
        fy_px=camera.fy_px * sy,
        cx_px=(camera.cx_px + 0.5) * sx - 0.5,
        cy_px=(camera.cy_px + 0.5) * sy - 0.5,
    )


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


def _invert_fisheye(bent: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
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
