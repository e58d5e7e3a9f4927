# SPDX-License-Identifier: Apache-2.0
"""Tet meshes of other programs: Gmsh's .msh, VTK's .vtu and .vtk, read in a process of its own."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import read_apart
from taccel_lab.files.declared import require_held
from taccel_lab.files.gmsh_file import MAX_BYTES, read_gmsh
from taccel_lab.files.regular_file import require_regular_file

SUFFIXES = (".msh", ".vtu", ".vtk")
MAX_TETS = 500_000
"""Of a gel; those of the catalogue have a tenth of it."""
_VTU_HEAD_BYTES = 1 << 16
"""Where the first piece of a .vtu file begins, within a kilobyte as a rule."""
_VTU_COUNT = re.compile(rb"""NumberOf(Points|Cells)\s*=\s*["']\s*(\d+)""")
_VTU_ITEM_BYTES = {b"Points": 12, b"Cells": 17}
"""Three coordinates; a type and four corners."""
_TETRA, _QUADRATIC_TETRA = 10, 24
"""VTK's numbers of the cells."""


def read_tet_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in the unit of the file, float64, [n, 3], and tets of no negative volume, int64,
    [t, 4].

    Nodes that no tet has are left out, and so are cells of other kinds. Tets of the second order
    keep their corners. Raises InputError for a file that cannot be read, has no tets or too many,
    and for coordinates that are not finite.
    """
    require_regular_file(path, MAX_BYTES, "a tet mesh (.msh, .vtu or .vtk)")
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: only {', '.join(SUFFIXES)} files can be read as tets")
    if suffix == ".msh":
        nodes, tets = read_apart(str(path), read_gmsh, path, by="numpy")
    else:
        if suffix == ".vtu":
            require_vtu_counts(path)
        nodes, tets = read_apart(str(path), _read_with_vtk, path, suffix, by="vtkmodules")
    if not len(tets):
        raise InputError(f"{path} holds no tets, or is not a readable mesh file")
    if len(tets) > MAX_TETS:
        raise InputError(
            f"{path} has {len(tets):,} tets; up to {MAX_TETS:,} are allowed: coarsen it"
        )
    if tets.min() < 0 or tets.max() >= len(nodes):
        raise InputError(f"{path} has tets of nodes that it does not have")
    bad = np.flatnonzero(~np.isfinite(nodes).all(axis=1))
    if len(bad):
        raise InputError(
            f"{path}: {len(bad)} of {len(nodes)} nodes have NaN or infinite coordinates "
            f"(the first is node {bad[0]})"
        )
    used, packed = np.unique(tets, return_inverse=True)
    nodes, tets = nodes[used], packed.reshape(-1, 4)
    corners = nodes[tets]
    with np.errstate(all="ignore"):  # Coordinates of 1e200 are for others to judge.
        inverted = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
    return nodes, tets


def require_vtu_counts(path: Path) -> None:
    """Refuse a .vtu file whose counts it cannot hold: VTK takes memory for them first."""
    with path.open("rb") as file:
        head = file.read(_VTU_HEAD_BYTES)
    for what, digits in _VTU_COUNT.findall(head):
        stated = int(digits[:20]) * _VTU_ITEM_BYTES[what]
        require_held(path, what.decode().lower(), stated, path.stat().st_size)


def _read_with_vtk(path: Path, suffix: str) -> tuple[np.ndarray, np.ndarray]:
    """What VTK makes of the file; runs in the readers' process."""
    import pyvista

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # VTK's own words about a broken file.
        loaded = pyvista.read(path, force_ext=suffix)
    if not isinstance(loaded, pyvista.UnstructuredGrid) or not loaded.n_cells:
        return np.zeros((0, 3)), np.zeros((0, 4), np.int64)
    tets = [
        np.asarray(cells)[:, :4]
        for kind, cells in loaded.cells_dict.items()
        if int(kind) in (_TETRA, _QUADRATIC_TETRA)
    ]
    found = np.concatenate(tets) if tets else np.zeros((0, 4))
    return np.asarray(loaded.points, dtype=np.float64), found.astype(np.int64)
