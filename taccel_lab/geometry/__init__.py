# SPDX-License-Identifier: Apache-2.0
"""Plain geometry types that every package may use: tet meshes, regions, pixel grids."""

from taccel_lab.geometry.pixel_grid import PixelGrid
from taccel_lab.geometry.quadratic import QuadraticMesh, quadratic_mesh
from taccel_lab.geometry.tet_mesh import Region, TetMesh

__all__ = ["PixelGrid", "QuadraticMesh", "Region", "TetMesh", "quadratic_mesh"]
