# SPDX-License-Identifier: Apache-2.0
"""Surfaces of a profile as triangles, and the STL and VTK files that other tools read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.exporters.frames import m_from_mm
from taccel_lab.geometry import TetMesh, stl
from taccel_lab.geometry.connectivity import compacted
from taccel_lab.profile import HousingBlock

if TYPE_CHECKING:
    import pyvista


def gel_surface(mesh: TetMesh) -> tuple[np.ndarray, np.ndarray]:
    """Closed outward surface of the gel: points [m] in the gel frame and triangles."""
    used, faces = compacted(mesh.faces)
    return mesh.nodes_m[used], faces


def housing_box(housing: HousingBlock) -> tuple[np.ndarray, np.ndarray]:
    """The housing's outer box, its front at ``front_z_mm``: points [m] in the gel frame and
    outward triangles."""
    half = np.array(housing.size_mm) / 2
    center = np.array([*housing.offset_mm, housing.front_z_mm - half[2]])
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return m_from_mm(center + corners * half), np.array(faces)


def write_stl(path: Path, points_m: np.ndarray, faces: np.ndarray) -> None:
    """Write triangles as binary STL; the unit of the numbers is the metre."""
    stl.write_stl(path, points_m[np.asarray(faces)], f"taccel_lab {path.stem}, metres")


def tet_grid(points_m: np.ndarray, tets: np.ndarray) -> pyvista.UnstructuredGrid:
    """Tets as VTK's unstructured grid."""
    import pyvista

    return pyvista.UnstructuredGrid({pyvista.CellType.TETRA: np.asarray(tets, dtype=np.int64)},
                                    np.asarray(points_m, dtype=np.float64))  # fmt: skip


def write_vtk(path: Path, grid: pyvista.UnstructuredGrid) -> None:
    """Write a grid as VTK's legacy file, binary."""
    from vtkmodules.vtkIOLegacy import vtkUnstructuredGridWriter

    writer = vtkUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileTypeToBinary()
    # VTK deletes or cuts short what a disk has no room for.
    writer.WriteToOutputStringOn()
    writer.Write()
    text = writer.GetOutputStdString()  # Bytes, unless they happen to be UTF-8.
    path.write_bytes(text.encode() if isinstance(text, str) else text)
