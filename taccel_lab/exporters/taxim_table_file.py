# SPDX-License-Identifier: Apache-2.0
"""A Taxim table that was fitted to captures, as a file: Taxim's own ``polycalib.npz``.

The arrays are those that taxim and TacEx read (``bins``, ``grad_r``, ``grad_g``, ``grad_b``, of
which ``grad_r`` is blue). Beside them, where they do not mind, stand the size of the images and the
figures of presses that the table was not fitted to. Files of others, without these, are read too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError, naming
from taccel_lab.exporters.taxim_table import TaximTable, bin_indices, bin_middles
from taccel_lab.files.arrays import read_npz
from taccel_lab.files.atomic_file import write_by
from taccel_lab.signals.normals import normals_from_slopes

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
