# SPDX-License-Identifier: Apache-2.0
"""Meshes that the product wrote as .vtu, read back by VTK."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista

from taccel_lab.geometry import TetMesh


def read_mesh_vtu(path: Path | str) -> TetMesh:
    grid = pyvista.read(path)
    assert isinstance(grid, pyvista.UnstructuredGrid)
    tets, faces = grid.cells_dict[10], grid.cells_dict[5]
    return TetMesh(np.asarray(grid.points), tets, faces, grid.cell_data["region"][len(tets) :])
