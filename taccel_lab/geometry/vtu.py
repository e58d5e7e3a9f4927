# SPDX-License-Identifier: Apache-2.0
"""Tet meshes as VTK XML unstructured grids (.vtu), for ParaView.

The file holds the tets as volume cells and the boundary triangles as surface cells; the cell array
``region`` names the ``Region`` of each triangle and is -1 on tets. Positions are in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file
from taccel_lab.geometry.quadratic import QuadraticMesh
from taccel_lab.geometry.tet_mesh import TetMesh


def write_mesh_vtu(
    path: Path | str,
    mesh: TetMesh | QuadraticMesh,
    *,
    positions_m: np.ndarray | None = None,
    point_data: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a labelled mesh, at rest or at the deformed ``positions_m`` [m], shape [node, 3].

    ``point_data`` are arrays of shape [node] or [node, k] by name. Of quadratic tets the volume
    cells have the corners only, the triangles all nodes.

    Raises InputError for positions or arrays of another length than the mesh's nodes.
    """
    import pyvista

    nodes = mesh.nodes_m if positions_m is None else np.asarray(positions_m, dtype=np.float64)
    if nodes.shape != mesh.nodes_m.shape:
        raise InputError(
            f"{path}: positions have shape {nodes.shape}, the mesh {mesh.nodes_m.shape}"
        )
    kinds = {pyvista.CellType.TETRA: mesh.tets[:, :4], pyvista.CellType.TRIANGLE: mesh.faces}
    cells = [np.insert(corners, 0, corners.shape[1], axis=1).ravel() for corners in kinds.values()]
    types = [np.full(len(corners), kind, dtype=np.uint8) for kind, corners in kinds.items()]
    grid = pyvista.UnstructuredGrid(np.concatenate(cells), np.concatenate(types), nodes)
    on_tets = np.full(len(mesh.tets), -1, dtype=np.int32)
    grid.cell_data["region"] = np.concatenate([on_tets, mesh.face_regions])
    for name, values in (point_data or {}).items():
        if len(values) != len(nodes):
            raise InputError(
                f"{path}: point array {name!r} has {len(values)} entries for {len(nodes)} nodes"
            )
        grid.point_data[name] = values
    with atomic_file(path) as staging:
        grid.save(str(staging))
