# SPDX-License-Identifier: Apache-2.0
"""A height map on the surface of an object: knurls, threads, letters, cloth.

It is laid over the object along the z axis of the object's frame, columns along x and rows along y,
as the sensor's image would show it, centred on the origin and repeated.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError, naming
from taccel_lab.geometry.length_units import other_readings

_LEAST_PX = 2
_DEPTHS_M, _WIDTHS_M = (1e-7, 1e-2), (1e-5, 1.0)
"""What gels show, and what is no slip of a unit."""


@dataclass(frozen=True)
class Texture:
    """Heights of a surface over its mean."""

    heights: np.ndarray
    """What stands out, 0 for the deepest and 1 for the highest, [row, column]."""
    depth_m: float
    """Height from the deepest to the highest [m]."""
    width_m: float
    """Width that all columns span together [m]; pixels are square."""

    def __post_init__(self) -> None:
        heights = np.asarray(self.heights)
        if heights.ndim != 2 or min(heights.shape) < _LEAST_PX or not np.isfinite(heights).all():
            raise InputError(
                f"a texture is a map of finite heights of at least {_LEAST_PX} x {_LEAST_PX}, got "
                f"shape {list(heights.shape)}"
            )
        if heights.min() < 0 or heights.max() > 1:
            raise InputError("the heights of a texture lie between 0 and 1")
        for name, value, (low, high) in (
            ("depth_m", self.depth_m, _DEPTHS_M),
            ("width_m", self.width_m, _WIDTHS_M),
        ):
            if not low <= value <= high:
                raise InputError(
                    f"{name} of a texture must lie in [{low:g}, {high:g}] m, got {value:g} m: "
                    f"{1e3 * value:g} mm; {other_readings(1e3 * value, 'millimetres')}"
                )

    @classmethod
    def from_image(cls, path: Path, depth_mm: float, width_mm: float) -> Texture:
        """A height map from an image: black is deepest, white stands out most.

        Args:
            path: PNG, JPEG or another image of one or three channels, whose mean counts.
            depth_mm: From black to white [mm].
            width_mm: That the image is wide on the object [mm].

        Raises:
            InputError: A file that is no image, one level everywhere, or lengths that are none.
        """
        from taccel_lab.files.images import read_image

        levels = read_image(path).astype(np.float64).mean(axis=-1)
        if np.ptp(levels) == 0:
            raise InputError(f"{path} has one level everywhere: there is no texture in it")
        with naming(path):
            return cls(levels / 255.0, 1e-3 * depth_mm, 1e-3 * width_mm)

    @property
    def mean_depth_m(self) -> float:
        """How deep the mean surface lies below the highest point [m]."""
        return self.depth_m * float(self.heights.max() - self.heights.mean())

    @property
    def relief_width_m(self) -> float:
        """Mean width of what stands out over the mean, and of what lies between [m]: area over the
        length of the borders, along rows and columns, of a map that goes on as it began."""
        over = self.heights > self.heights.mean()
        borders = sum(int((over != np.roll(over, 1, axis)).sum()) for axis in (0, 1))
        return self.width_m / over.shape[1] * over.size / max(borders, 1)

    def relief_m(self) -> np.ndarray:
        """How far the surface stands out over its mean [m], [row, column]."""
        return self.depth_m * (self.heights - self.heights.mean())
