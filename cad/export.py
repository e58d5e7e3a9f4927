# SPDX-License-Identifier: Apache-2.0
"""Files for the workshop: STEP with named and coloured faces, STL in millimetres, dimensions."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Interface import Interface_Static
from OCP.Message import Message, Message_Gravity
from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

from cad.mesh.surface import LabelledSurface
from cad.parts.labelled_solid import LabelledSolid
from cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

REGION_COLORS: dict[Region, tuple[float, float, float]] = {
    Region.SIDE: (0.62, 0.64, 0.67),
    Region.CONTACT: (0.90, 0.55, 0.20),
    Region.BOND: (0.20, 0.42, 0.70),
    Region.WINDOW: (0.45, 0.78, 0.85),
}
"""RGB of each region, 0..1, in files and pictures."""


def write_step(part: LabelledSolid, path: Path, *, name: str = "gel_pad") -> None:
    """Write the solid as STEP AP214 in mm; each face carries the name and colour of its region."""
    document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colors = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    label = shapes.AddShape(part.solid.wrapped, False)
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
    for face, region in zip(part.solid.faces(), part.regions, strict=True):
        face_label = shapes.AddSubShape(label, face.wrapped)
        TDataStd_Name.Set_s(face_label, TCollection_ExtendedString(region.name.lower()))
        color = Quantity_Color(*REGION_COLORS[region], Quantity_TypeOfColor.Quantity_TOC_sRGB)
        colors.SetColor(face_label, color, XCAFDoc_ColorType.XCAFDoc_ColorSurf)
    for printer in Message.DefaultMessenger_s().Printers():
        printer.SetTraceLevel(Message_Gravity.Message_Fail)
    # The writer registers the settings, so it has to exist before they can be changed.
    writer = STEPCAFControl_Writer()
    if not Interface_Static.SetIVal_s("write.stepcaf.subshapes.name", 1):
        raise RuntimeError("this OCCT cannot write the names of faces to STEP")
    writer.SetNameMode(True)
    writer.SetColorMode(True)
    writer.Transfer(document)
    if writer.Write(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise InputError(f"the CAD kernel could not write {path}")


def write_stl(surface: LabelledSurface, path: Path) -> None:
    """Write a closed surface as binary STL in mm; STL itself names no unit."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.zeros(len(surface.triangles), dtype=record)
    triangles["normal"] = surface.normals()
    triangles["corners"] = surface.vertices_mm[surface.triangles]
    with path.open("wb") as file:
        file.write(b"taccel_lab gel pad, millimetres".ljust(80, b"\0"))
        file.write(np.array(len(triangles), dtype="<u4").tobytes())
        file.write(triangles.tobytes())


def dimensions(part: LabelledSolid, pad: Pad) -> dict[str, Any]:
    """Measured dimensions of the solid [mm, mm^2, mm^3], for the workshop's drawing."""
    box = part.solid.bounding_box()
    return {
        "unit": "mm",
        "frame": "x right and y down in the image, z out of the gel; origin at the apex",
        "bounding_box_min": [box.min.X, box.min.Y, box.min.Z],
        "bounding_box_max": [box.max.X, box.max.Y, box.max.Z],
        "volume_mm3": part.solid.volume,
        "area_mm2": {region.name.lower(): part.area_mm2(region) for region in Region},
        **pad.figures(),
        "pad": pad.values(),
    }
