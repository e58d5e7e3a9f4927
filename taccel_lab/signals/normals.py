# SPDX-License-Identifier: Apache-2.0
"""Outward unit normals of a height map: ``n = (-dh/dx, -dh/dy, 1) / |.|`` in the gel frame."""

from __future__ import annotations

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.tensors import Array, as_given, tensor_of


def normals_from_slopes(slope: np.ndarray) -> np.ndarray:
    """Outward unit normals from the gradient of the height.

    Args:
        slope: dh/dx and dh/dy, dimensionless, shape [..., 2]; NaN where there is no surface.

    Returns:
        Shape [..., 3], NaN where the slope is.
    """
    slope = np.asarray(slope, dtype=np.float64)
    normals = np.empty((*slope.shape[:-1], 3))
    inverse = 1.0 / np.sqrt(1.0 + slope[..., 0] ** 2 + slope[..., 1] ** 2)
    normals[..., 0] = -slope[..., 0] * inverse
    normals[..., 1] = -slope[..., 1] * inverse
    normals[..., 2] = inverse
    return normals


def slopes_from_height(height_m: np.ndarray, grid: PixelGrid) -> np.ndarray:
    """Gradient of a height map that comes without one, by pixel differences.

    Central differences where both neighbours exist, one-sided beside NaN and the image border, NaN
    where the pixel itself is NaN or has no neighbour along an axis. Signals of this package give
    analytic slopes; use those where you can.

    Args:
        height_m: Height [m], shape [..., height_px, width_px].
        grid: Its pixel grid.

    Returns:
        dh/dx, dh/dy, shape [..., height_px, width_px, 2].
    """
    height_m = np.asarray(height_m, dtype=np.float64)
    if height_m.ndim < 2 or height_m.shape[-2:] != (grid.height_px, grid.width_px):
        raise InputError(
            f"height map of shape {height_m.shape} does not fit the pixel grid "
            f"{grid.width_px}x{grid.height_px}"
        )
    along_x = _difference(height_m, grid.mm_per_px_x * 1e-3)
    along_y = _difference(height_m.swapaxes(-1, -2), grid.mm_per_px_y * 1e-3).swapaxes(-1, -2)
    return np.stack([along_x, along_y], axis=-1)


def _difference(height_m: np.ndarray, step_m: float) -> np.ndarray:
    """Derivative along the last axis, central or one-sided as the neighbours allow."""
    forward = np.full_like(height_m, np.nan)
    forward[..., :-1] = np.diff(height_m, axis=-1) / step_m
    backward = np.full_like(height_m, np.nan)
    backward[..., 1:] = forward[..., :-1]
    central = 0.5 * (forward + backward)
    one_sided = np.where(np.isnan(forward), backward, forward)
    return np.where(np.isnan(central), one_sided, central)


def normals_from_height(height_m: np.ndarray, grid: PixelGrid) -> np.ndarray:
    """Outward unit normals of a height map by pixel differences, shape [..., h, w, 3]."""
    return normals_from_slopes(slopes_from_height(height_m, grid))


def rotate_from_z(vectors: Array, rest_normals: Array) -> Array:
    """Vectors given relative to the resting normal, in the gel frame, shape [..., 3].

    The frame of a pixel is turned by the smallest rotation that takes +z to its resting normal.
    """
    import torch

    x, y, z = tensor_of(rest_normals).unbind(dim=-1)
    a, b, c = tensor_of(vectors).unbind(dim=-1)
    # R = I + [k]x + [k]x^2 / (1 + z) with k = ez x n = (-y, x, 0).
    across = (x * a + y * b) / (1.0 + z)
    turned = [a - x * across + x * c, b - y * across + y * c, c * z - x * a - y * b]
    return as_given(torch.stack(turned, dim=-1), vectors)


def rotate_to_z(vectors: np.ndarray, rest_normals: np.ndarray) -> np.ndarray:
    """Inverse of ``rotate_from_z``."""
    mirrored = rest_normals * np.array([-1.0, -1.0, 1.0])
    return rotate_from_z(vectors, mirrored)
