# SPDX-License-Identifier: Apache-2.0
"""Files for the workshop: STEP with named and coloured faces, STL, 3MF and DXF in millimetres."""

from cad.export.dimensions import dimensions
from cad.export.dxf import write_dxf
from cad.export.step import write_assembly_step, write_part_step, write_step
from cad.export.stl import write_part_stl, write_stl
from cad.export.threemf import write_3mf
from cad.parts.part import REGION_COLORS

__all__ = [
    "REGION_COLORS",
    "dimensions",
    "write_3mf",
    "write_assembly_step",
    "write_dxf",
    "write_part_step",
    "write_part_stl",
    "write_step",
    "write_stl",
]
