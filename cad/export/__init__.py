# SPDX-License-Identifier: Apache-2.0
"""Files for the workshop: STEP with named and coloured faces, STL, 3MF and DXF in millimetres."""

from taccel_lab.cad.export.dimensions import dimensions
from taccel_lab.cad.export.dxf import write_dxf
from taccel_lab.cad.export.step import write_assembly_step, write_part_step, write_step
from taccel_lab.cad.export.stl import write_part_stl, write_stl
from taccel_lab.cad.export.threemf import write_3mf

__all__ = [
    "dimensions",
    "write_3mf",
    "write_assembly_step",
    "write_dxf",
    "write_part_step",
    "write_part_stl",
    "write_step",
    "write_stl",
]
