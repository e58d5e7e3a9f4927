# SPDX-License-Identifier: Apache-2.0
"""Taxim's colour table: a quadratic over the image for every bin of surface normals.

Z. Si and W. Yuan, "Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L
2022. The tilt of the normal (0 to 90 degrees) and its direction (-180 to 180) are cut into equal
bins; in each, the change of each colour is ``c . (u^2, v^2, u v, u, v, 1)`` of the pixel (u, v).
The one evaluation and the one file format: fits of captures and tables made from another model
both end here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError

TERMS = 6
ChannelOrder = Literal["rgb", "bgr"]


@dataclass(frozen=True)
class TaximTable:
    """Colour change by tilt and direction of the outward normal in the gel frame."""

    bins: int
    """Bins of tilt, and of direction."""
    grad_rgb: np.ndarray
    """Coefficients [levels of 255], float64, shape [3, bins (tilt), bins (direction), 6]."""

    def __post_init__(self) -> None:
        grad = np.asarray(self.grad_rgb, dtype=np.float64)
        expected = (3, self.bins, self.bins, TERMS)
        if self.bins < 2 or grad.shape != expected:
            raise InputError(f"a Taxim table of {self.bins} bins has shape {expected}, got "
                             f"{grad.shape}")  # fmt: skip
        if not np.isfinite(grad).all():
            raise InputError("the Taxim table holds NaN or infinite values")
        object.__setattr__(self, "grad_rgb", grad)

    def change(self, normals: np.ndarray) -> np.ndarray:
        """Colour change [levels of 255], RGB, shape [..., height_px, width_px, 3].

        ``normals`` are outward unit normals in the gel frame, shape [..., height_px, width_px, 3].
        """
        height, width = normals.shape[-3:-1]
        tilt, direction = bin_indices(normals, self.bins)
        v, u = np.mgrid[0:height, 0:width]
        return np.einsum("c...k,...k->...c", self.grad_rgb[:, tilt, direction], pixel_terms(u, v))

    def arrays(self, order: ChannelOrder, *, turned: bool = False) -> dict[str, np.ndarray]:
        """Contents of ``polycalib.npz``: ``bins`` and ``grad_r``, ``grad_g``, ``grad_b``.

        ``order`` says which channel of the file comes first in the reader's RGB image: Taxim's own
        files hold blue as ``grad_r`` ("bgr"), those of Isaac Lab red ("rgb"). ``turned`` is for a
        reader that takes the gradient of the height instead of the normal's direction, half a turn
        apart (Isaac Lab).
        """
        grad = self.grad_rgb[:, :, half_turn(self.bins)] if turned else self.grad_rgb
        red, green, blue = grad
        first, last = (red, blue) if order == "rgb" else (blue, red)
        return {"bins": np.array(self.bins), "grad_r": first, "grad_g": green, "grad_b": last}

    @classmethod
    def from_arrays(
        cls, arrays: dict[str, np.ndarray], order: ChannelOrder, *, turned: bool = False
    ) -> TaximTable:
        """Inverse of ``arrays``, but for the bins that half a turn cannot reach exactly."""
        missing = {"grad_r", "grad_g", "grad_b"} - set(arrays)
        if missing:
            raise InputError(f"the Taxim table lacks {', '.join(sorted(missing))}")
        first, green, last = (np.asarray(arrays[f"grad_{c}"]) for c in "rgb")
        red, blue = (first, last) if order == "rgb" else (last, first)
        grad = np.stack([red, green, blue])
        bins = grad.shape[1]
        return cls(bins, grad[:, :, half_turn(bins)] if turned else grad)


def bin_indices(normals: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Bins of tilt and direction of outward unit normals [..., 3], each of shape [...].

    Tilt is ``atan(|(n_x, n_y)| / n_z)``, direction ``atan2(n_y, n_x)``, 0 where there is no tilt.
    """
    normals = np.asarray(normals, dtype=np.float64)
    across = np.hypot(normals[..., 0], normals[..., 1])
    tilt = np.arctan2(across, normals[..., 2])
    direction = np.where(across > 0, np.arctan2(normals[..., 1], normals[..., 0]), 0.0)
    step_tilt, step_direction = bin_steps(bins)
    return (
        np.clip(np.floor(tilt / step_tilt).astype(np.int64), 0, bins - 1),
        np.clip(np.floor((direction + np.pi) / step_direction).astype(np.int64), 0, bins - 1),
    )


def bin_steps(bins: int) -> tuple[float, float]:
    """Widths of a bin of tilt and of direction [rad]; the last bin of each holds its end only."""
    return 0.5 * np.pi / (bins - 1), 2 * np.pi / (bins - 1)


def half_turn(bins: int) -> np.ndarray:
    """Bin of direction that lies opposite to the middle of each, shape [bins]."""
    _, step = bin_steps(bins)
    middle = (np.arange(bins) + 0.5) * step
    return np.floor(np.mod(middle + np.pi, 2 * np.pi) / step).astype(np.int64)


def pixel_terms(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The terms u^2, v^2, u v, u, v, 1 of pixels, shape [..., 6]."""
    u, v = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=-1)
