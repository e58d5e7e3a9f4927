# SPDX-License-Identifier: Apache-2.0
"""Taxim's colour table: a quadratic over the image for every bin of surface normals.

Z. Si and W. Yuan, "Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L
2022. The tilt of the normal (0 to 90 degrees) and its direction (-180 to 180) are cut into equal
bins; in each, the change of each colour is ``c . (u^2, v^2, u v, u, v, 1)`` of the pixel (u, v).
The one evaluation and the one file format: fits of captures and tables made from another model
both end here.

A table that was fitted to captures is a file, Taxim's own ``polycalib.npz``, whose arrays taxim and
TacEx read (``bins``, ``grad_r``, ``grad_g``, ``grad_b``, of which ``grad_r`` is blue). Beside them,
where they do not mind, stand the size of the images and the figures of presses that the table was
not fitted to. Files of others, without these, are read too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError, naming
from taccel_lab.files.arrays import read_npz
from taccel_lab.files.atomic_file import write_by
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.normals import normals_from_slopes

TERMS = 6
ChannelOrder = Literal["rgb", "bgr"]
"""Which channel a reader's ``grad_r`` is: Taxim's own files hold blue there ("bgr", they were
fitted to OpenCV's images), those of Isaac Lab red."""
Direction = Literal["normal", "gradient"]
"""What the bins of direction measure: the outward normal (Taxim, whose height maps grow into the
gel) or the gradient of the height, half a turn apart (Isaac Lab)."""


@dataclass(frozen=True)
class TaximTable:
    """Colour change by tilt and direction of the surface in the gel frame."""

    bins: int
    """Bins of tilt, and of direction."""
    grad_rgb: np.ndarray
    """Coefficients [levels of 255], float64, shape [3, bins (tilt), bins (direction), 6]."""
    direction: Direction = "normal"

    def __post_init__(self) -> None:
        grad = np.asarray(self.grad_rgb, dtype=np.float64)
        expected = (3, self.bins, self.bins, TERMS)
        if self.bins < 2 or grad.shape != expected:
            raise InputError(
                f"a Taxim table of {self.bins} bins has shape {expected}, got {grad.shape}"
            )
        if not np.isfinite(grad).all():
            raise InputError("the Taxim table holds NaN or infinite values")
        object.__setattr__(self, "grad_rgb", grad)

    def change(self, normals: np.ndarray) -> np.ndarray:
        """Colour change [levels of 255], RGB, shape [..., height_px, width_px, 3].

        ``normals`` are outward unit normals in the gel frame, shape [..., height_px, width_px, 3].
        """
        v, u = np.mgrid[0 : normals.shape[-3], 0 : normals.shape[-2]]
        return self.change_at(normals, u, v)

    def change_at(self, normals: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Colour change [levels of 255] at pixels (u, v) of shape [...] with normals [..., 3]."""
        tilt, direction = bin_indices(normals, self.bins, self.direction)
        coefficients = self.grad_rgb[:, tilt, direction]
        return np.einsum("c...k,...k->...c", coefficients, pixel_terms(u, v))

    def arrays(self, order: ChannelOrder) -> dict[str, np.ndarray]:
        """Contents of ``polycalib.npz``: ``bins`` and ``grad_r``, ``grad_g``, ``grad_b``."""
        first, green, last = self.grad_rgb if order == "rgb" else self.grad_rgb[::-1]
        return {"bins": np.array(self.bins), "grad_r": first, "grad_g": green, "grad_b": last}

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, np.ndarray],
        order: ChannelOrder,
        direction: Direction = "normal",
    ) -> TaximTable:
        """Inverse of ``arrays``; InputError when they are not those of a table."""
        missing = {"grad_r", "grad_g", "grad_b"} - set(arrays)
        if missing:
            raise InputError(f"the Taxim table lacks {', '.join(sorted(missing))}")
        parts = [np.asarray(arrays[f"grad_{channel}"]) for channel in "rgb"]
        for channel, part in zip("rgb", parts, strict=True):
            if part.ndim != 3 or part.shape != parts[0].shape or part.dtype.kind not in "fiu":
                raise InputError(
                    f"grad_{channel} of the Taxim table has shape {part.shape} and type "
                    f"{part.dtype}; all three need [bins, bins, {TERMS}] and numbers"
                )
        grad = np.stack(parts)
        return cls(grad.shape[1], grad if order == "rgb" else grad[::-1], direction)


def bin_indices(
    normals: np.ndarray, bins: int, direction: Direction = "normal"
) -> tuple[np.ndarray, np.ndarray]:
    """Bins of tilt and direction of outward unit normals [..., 3], each of shape [...].

    Tilt is ``atan(|(n_x, n_y)| / n_z)``; direction ``atan2(n_y, n_x)`` of the normal, or of its
    opposite for the gradient; 0 where there is no tilt.
    """
    normals = np.asarray(normals, dtype=np.float64)
    sign = 1.0 if direction == "normal" else -1.0
    across = np.hypot(normals[..., 0], normals[..., 1])
    angle = np.where(across > 0, np.arctan2(sign * normals[..., 1], sign * normals[..., 0]), 0.0)
    step_tilt, step_angle = bin_steps(bins)
    tilt_bin = np.floor(np.arctan2(across, normals[..., 2]) / step_tilt).astype(np.int64)
    angle_bin = np.floor((angle + np.pi) / step_angle).astype(np.int64)
    return np.clip(tilt_bin, 0, bins - 1), np.clip(angle_bin, 0, bins - 1)


def bin_steps(bins: int) -> tuple[float, float]:
    """Widths of a bin of tilt and of direction [rad]; the last bin of each holds its end only."""
    return 0.5 * np.pi / (bins - 1), 2 * np.pi / (bins - 1)


def bin_middles(bins: int) -> np.ndarray:
    """Unit normals in the middle of each bin of tilt and direction, shape [bins, bins, 3].

    The last bins of tilt, which reach over 90 degrees, are asked for right below it.
    """
    step_tilt, step_angle = bin_steps(bins)
    tilt = np.minimum((np.arange(bins)[:, None] + 0.5) * step_tilt, np.pi / 2 - 1e-6)
    angle = (np.arange(bins)[None, :] + 0.5) * step_angle - np.pi
    across = np.sin(tilt)
    return np.stack(
        np.broadcast_arrays(across * np.cos(angle), across * np.sin(angle), np.cos(tilt)), axis=-1
    )


def one_scale(grid: PixelGrid) -> tuple[float, np.ndarray]:
    """The one mm/px for a reader that knows no two, and by how much the slopes along x and y that
    it then measures are too small, shape [2]."""
    scale = float(np.sqrt(grid.mm_per_px_x * grid.mm_per_px_y))
    return scale, np.array([scale / grid.mm_per_px_x, scale / grid.mm_per_px_y])


def pixel_terms(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The terms u^2, v^2, u v, u, v, 1 of pixels, shape [..., 6]."""
    u, v = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=-1)


TABLE_FILE = "polycalib.npz"
_SIZE = "image_size_px"
_FIGURE = "figure_"


@dataclass(frozen=True)
class TableFile:
    """The table and what its file says of it."""

    table: TaximTable
    image_size_px: tuple[int, int] | None = None
    """Width and height of the images that its polynomials count over; None when not stated."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Errors on presses that it was not fitted to, by name; units in the names."""


def write_table(file: TableFile, path: Path) -> None:
    """Write ``polycalib.npz``; the folder that it goes to is what appears whole."""
    arrays = file.table.arrays("bgr")
    if file.image_size_px is not None:
        arrays[_SIZE] = np.array(file.image_size_px)
    arrays |= {_FIGURE + name: np.array(value) for name, value in file.figures.items()}
    write_by(path, partial(np.savez_compressed, **arrays))


def read_table(path: Path) -> TableFile:
    """Read ``polycalib.npz``.

    Raises:
        InputError: It cannot be read as an NPZ, or it holds no whole table.
    """
    arrays = read_npz(path)
    with naming(path):
        table = TaximTable.from_arrays(arrays, "bgr")
    size = arrays.get(_SIZE)
    if size is not None and (size.shape != (2,) or size.dtype.kind not in "iu"):
        raise InputError(f"{path}: {_SIZE} must be two whole numbers, got {size.tolist()}")
    return TableFile(
        table,
        None if size is None else (int(size[0]), int(size[1])),
        {
            name.removeprefix(_FIGURE): float(value)
            for name, value in arrays.items()
            if name.startswith(_FIGURE) and value.shape == () and value.dtype.kind in "iuf"
        },
    )


def for_one_scale(table: TaximTable, stretch: np.ndarray) -> TaximTable:
    """The table for a reader that measures slopes ``stretch`` [2] times too small along x and y.

    Each of its bins gets what the table holds at the slope that is meant.
    """
    if np.allclose(stretch, 1.0, rtol=0, atol=1e-6):
        return table
    seen = bin_middles(table.bins)
    slope = -seen[..., :2] / seen[..., 2:] * stretch
    tilt, direction = bin_indices(normals_from_slopes(slope), table.bins, table.direction)
    return TaximTable(table.bins, table.grad_rgb[:, tilt, direction], table.direction)
