# SPDX-License-Identifier: Apache-2.0
"""Meshes as VTK reads them, in the readers' process: .vtu and .vtk grids, STL, PLY and OBJ.

VTK believes what a file says of its counts; where that is wrong it crashes, never ends or gives
a part.
"""

from __future__ import annotations

import mmap
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.declared import require_few, require_held

TETRA, TRIANGLE, QUADRATIC_TETRA = 10, 5, 24
"""VTK's numbers of cells."""
MAX_COMPONENTS = 64
"""Most components of an array's item; a tensor of rank 2 has nine."""
_COUNT = re.compile(rb"""NumberOf(Points|Cells|Tuples|Components)\s*=\s*["']\s*(\d+)""")
_ITEM_BYTES = {b"Points": 12, b"Cells": 17, b"Tuples": 1}
"""Three coordinates; a type and four corners."""


def read_vtk(path: Path, suffix: str) -> Any:
    """What pyvista makes of a file, whatever its name.

    Raises InputError for counts that the file cannot hold, and for what VTK refuses.
    """
    import pyvista

    if suffix == ".vtu":
        _check_counts(path)
    with warnings.catch_warnings():
        # VTK's own words about a broken file; what is wrong is said by whoever gets nothing.
        warnings.simplefilter("ignore")
        try:
            # It would go by the file that a link leads to, which git-annex and DVC name by digest.
            return pyvista.read(path, force_ext=suffix)
        except (RuntimeError, ValueError, TypeError, LookupError) as error:
            raise _damaged(path, error) from None


def cells_of(path: Path, grid: Any) -> dict[int, np.ndarray]:
    """Nodes of an unstructured grid's cells by VTK's number of their kind, int64, [cell, node];
    InputError where its lists do not fit one another."""
    try:
        return {int(k): np.asarray(v, dtype=np.int64) for k, v in grid.cells_dict.items()}
    except (RuntimeError, ValueError, TypeError, LookupError, OverflowError) as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> InputError:
    words = " ".join(str(error).split())[:200]
    return InputError(f"{path} is not a readable mesh file, or is damaged ({words})")


def _check_counts(path: Path) -> None:
    size = path.stat().st_size
    if not size:
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for what, digits in _COUNT.findall(data):
            count = int(digits[:20])
            if what != b"Components":
                require_held(path, what.decode().lower(), count * _ITEM_BYTES[what], size)
            else:
                require_few(path, "components of an array's item", count, MAX_COMPONENTS)
