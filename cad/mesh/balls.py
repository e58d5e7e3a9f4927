# SPDX-License-Identifier: Apache-2.0
"""Soft bodies of free form: unions of balls, meshed by fTetWild.

``python -m taccel_lab.cad.mesh.balls tasks/files/bear.vtk`` writes the bear of the task
``soft-bear``. The file is kept, as another version of fTetWild may mesh another way.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyvista

from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.mesh.tetwild import TetWildInput, run_tetwild
from taccel_lab.geometry import Region, TetMesh

BEAR = (
    (0.0, 0.0, 14.0, 13.0),  # Belly.
    (0.0, -1.0, 32.0, 10.0),  # Head.
    (0.0, -10.0, 30.0, 4.5),  # Snout.
    (8.0, 1.0, 39.5, 4.0), (-8.0, 1.0, 39.5, 4.0),  # Ears.
    (12.0, -5.0, 19.0, 4.5), (-12.0, -5.0, 19.0, 4.5),  # Arms.
    (8.5, -9.0, 5.5, 5.5), (-8.5, -9.0, 5.5, 5.5),  # Legs.
    (0.0, 11.0, 5.0, 5.0),  # Tail, on which it sits.
)  # fmt: skip
"""Middle and radius of each ball [mm]; it sits on z = 0 and looks along -y."""
EPSILON, WANTED_DEG = 1e-2, 10.0


def balls_mesh(balls: np.ndarray, edge_mm: float) -> TetMesh:
    """The union of balls, x, y, z and radius each [mm], [n, 4], in tets of about ``edge_mm``; all
    of its surface can touch something."""
    balls = np.asarray(balls, dtype=np.float64)
    step = edge_mm
    low = (balls[:, :3] - balls[:, 3:]).min(axis=0) - 2 * step
    high = (balls[:, :3] + balls[:, 3:]).max(axis=0) + 2 * step
    grid = pyvista.ImageData(
        dimensions=(np.ceil((high - low) / step).astype(int) + 1).tolist(),
        spacing=(step, step, step),
        origin=low.tolist(),
    )
    away = np.linalg.norm(grid.points[:, None] - balls[:, :3], axis=2) - balls[:, 3]
    surface = grid.contour([0.0], scalars=away.min(axis=1)).clean().triangulate()  # type: ignore[attr-defined]
    surface = surface.compute_normals(auto_orient_normals=True, consistent_normals=True)
    triangles = surface.faces.reshape(-1, 4)[:, 1:].astype(np.int32)
    sides = np.full(len(triangles), int(Region.SIDE), dtype=np.int32)
    labelled = LabelledSurface(np.asarray(surface.points, dtype=np.float64), triangles, sides)
    given = TetWildInput(labelled, np.zeros((0, 3, 3)), lambda points: points)
    return run_tetwild(given, edge_mm, EPSILON, wanted_deg=WANTED_DEG)


def main(path: Path) -> None:
    """Write the bear, in metres, as a legacy VTK file in binary."""
    mesh = balls_mesh(np.array(BEAR), edge_mm=4.0)
    cells = np.column_stack([np.full(mesh.tet_count, 4), mesh.tets])
    kinds = np.full(mesh.tet_count, int(pyvista.CellType.TETRA))
    pyvista.UnstructuredGrid(cells, kinds, mesh.nodes_m).save(path, binary=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
