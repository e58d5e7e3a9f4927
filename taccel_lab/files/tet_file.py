# SPDX-License-Identifier: Apache-2.0
"""Tet meshes of other programs: Gmsh's .msh, VTK's .vtu and .vtk, read in a process of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import read_apart
from taccel_lab.files.gmsh_file import MAX_BYTES, read_gmsh
from taccel_lab.files.regular_file import require_regular_file
from taccel_lab.files.vtk_mesh import QUADRATIC_TETRA, TETRA, cells_of, read_vtk

SUFFIXES = (".msh", ".vtu", ".vtk")
MAX_TETS = 500_000
"""Most tetrahedra of a gel; those of the catalogue have a tenth of it."""


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


def _read_with_vtk(path: Path, suffix: str) -> tuple[np.ndarray, np.ndarray]:
    """What VTK makes of the file; runs in the readers' process."""
    import pyvista

    loaded = read_vtk(path, suffix)
    if not isinstance(loaded, pyvista.UnstructuredGrid) or not loaded.n_cells:
        return np.zeros((0, 3)), np.zeros((0, 4), np.int64)
    cells = cells_of(path, loaded)
    tets = [cells[kind][:, :4] for kind in (TETRA, QUADRATIC_TETRA) if kind in cells]
    found = np.concatenate(tets) if tets else np.zeros((0, 4), np.int64)
    return np.asarray(loaded.points, dtype=np.float64), found
