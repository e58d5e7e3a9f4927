# SPDX-License-Identifier: Apache-2.0
"""The orthographic pixel grid on which tactile images, height maps and normals live."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.typed import typed


@typed
@dataclass(frozen=True)
class PixelGrid:
    """Pixel centres of an image laid over the gel, in the gel frame.

    The gel frame has x to the right of the image, y down the image and z out of the gel (away
    from the camera). Its origin lies on the undeformed contact face at the pad's centre. Pixel
    (0, 0) is the centre of the top left pixel.
    """

    width_px: int
    height_px: int
    mm_per_px_x: float
    mm_per_px_y: float
    center_u_px: float = None  # type: ignore[assignment]  # __post_init__ fills it in
    """Column of the gel frame's origin [px]; the image centre when None."""
    center_v_px: float = None  # type: ignore[assignment]  # __post_init__ fills it in
    """Row of the gel frame's origin [px]; the image centre when None."""

    def __post_init__(self) -> None:
        if self.width_px < 2 or self.height_px < 2:
            raise InputError(
                f"an image needs at least 2x2 px, got {self.width_px}x{self.height_px}"
            )
        for name in ("mm_per_px_x", "mm_per_px_y"):
            value = getattr(self, name)
            most = self._most_mm_per_px()
            if not (math.isfinite(value) and 1e-4 <= value <= most):
                raise InputError(f"{name} must lie in [1e-4, {most:g}] mm per pixel, got {value}")
        if self.center_u_px is None:
            object.__setattr__(self, "center_u_px", (self.width_px - 1) / 2)
        if self.center_v_px is None:
            object.__setattr__(self, "center_v_px", (self.height_px - 1) / 2)

    def _most_mm_per_px(self) -> float:
        return 1.0

    def x_mm(self) -> np.ndarray:
        """Gel x of each column [mm], shape [width_px]."""
        return (np.arange(self.width_px) - self.center_u_px) * self.mm_per_px_x

    def y_mm(self) -> np.ndarray:
        """Gel y of each row [mm], shape [height_px]."""
        return (np.arange(self.height_px) - self.center_v_px) * self.mm_per_px_y

    def refined(self, points: int) -> PixelGrid:
        """Return the same part of the gel in ``points`` x ``points`` pixels for each of these."""
        return PixelGrid(
            self.width_px * points,
            self.height_px * points,
            self.mm_per_px_x / points,
            self.mm_per_px_y / points,
            (self.center_u_px + 0.5) * points - 0.5,
            (self.center_v_px + 0.5) * points - 0.5,
        )

    def thinned(self, every: int) -> PixelGrid:
        """Return blocks of ``every`` times ``every`` pixels; the last ones may be cut off."""
        return _BlockGrid(
            -(-self.width_px // every),
            -(-self.height_px // every),
            self.mm_per_px_x * every,
            self.mm_per_px_y * every,
            (self.center_u_px + 0.5) / every - 0.5,
            (self.center_v_px + 0.5) / every - 0.5,
        )

    def gel_from_pixel(self, uv_px: np.ndarray) -> np.ndarray:
        """Gel xy [mm] of pixel coordinates (u, v), shape [..., 2]."""
        uv = np.asarray(uv_px, dtype=np.float64)
        return np.stack(
            [
                (uv[..., 0] - self.center_u_px) * self.mm_per_px_x,
                (uv[..., 1] - self.center_v_px) * self.mm_per_px_y,
            ],
            axis=-1,
        )

    def pixel_from_gel(self, xy_mm: np.ndarray) -> np.ndarray:
        """Pixel coordinates (u, v), [..., 2], of gel xy [mm], [..., 2], or of points, [..., 3]."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        return np.stack(
            [
                xy[..., 0] / self.mm_per_px_x + self.center_u_px,
                xy[..., 1] / self.mm_per_px_y + self.center_v_px,
            ],
            axis=-1,
        )

    def contains(self, xy_mm: np.ndarray) -> np.ndarray:
        """Tell whether points of the gel [mm], [..., 2] or [..., 3], lie in the image, bool,
        [...]."""
        u, v = np.moveaxis(self.pixel_from_gel(xy_mm), -1, 0)
        inside = (u > -0.5) & (u < self.width_px - 0.5)
        return inside & (v > -0.5) & (v < self.height_px - 0.5)

    def resized(self, width_px: int, height_px: int) -> PixelGrid:
        """Return the same view in other pixels."""
        across, down = self.width_px / width_px, self.height_px / height_px
        return PixelGrid(
            width_px,
            height_px,
            self.mm_per_px_x * across,
            self.mm_per_px_y * down,
            (self.center_u_px + 0.5) / across - 0.5,
            (self.center_v_px + 0.5) / down - 0.5,
        )


class _BlockGrid(PixelGrid):
    """Blocks of pixels, which may be coarser than any image."""

    def _most_mm_per_px(self) -> float:
        return math.inf
