# SPDX-License-Identifier: Apache-2.0
"""Files for the workshop: STEP with named and coloured faces, STL, 3MF and DXF in millimetres."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from build123d import (
    Color,
    Edge,
    ExportDXF,
    Face,
    Location,
    Mesher,
    Plane,
    Pos,
    Solid,
    Unit,
    Wire,
)
from build123d.exporters import ColorIndex
from build123d.topology import Shape
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Interface import Interface_Static
from OCP.Message import Message, Message_Gravity
from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.cad.parts.part import LabelledSolid, Part, Rgb, gel_part
from taccel_lab.cad.parts.solids import base_outline, section_faces
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_by
from taccel_lab.geometry import Region, stl

DEVIATION_MM, ANGLE_RAD = 0.005, 0.06
SECTION_GAP_MM = 10.0
"""Distance between the plan and the section drawn under it."""
_LAYERS = {
    "outline": ColorIndex.BLACK,
    "window": ColorIndex.CYAN,
    "seat": ColorIndex.BLUE,
    "section": ColorIndex.RED,
}


def dimensions(part: LabelledSolid, pad: Pad | None = None) -> dict[str, Any]:
    """Measured dimensions of the solid [mm, mm^2, mm^3], for the workshop's drawing."""
    box = part.solid.bounding_box()
    measured = {
        "unit": "mm",
        "frame": "x right and y down in the image, z out of the gel; origin at the apex",
        "bounding_box_min": [box.min.X, box.min.Y, box.min.Z],
        "bounding_box_max": [box.max.X, box.max.Y, box.max.Z],
        "volume_mm3": part.volume_mm3,
        "area_mm2": {region.name.lower(): part.area_mm2(region) for region in Region},
    }
    if pad is None:
        return measured
    return {**measured, **pad.figures(), "pad": pad.values()}


def write_step(part: LabelledSolid, path: Path, *, name: str = "gel_pad") -> None:
    """Write the solid as STEP AP214 in mm; each face carries the name and colour of its region."""
    write_part_step(gel_part(part, name), path)


def write_part_step(part: Part, path: Path) -> None:
    """Write one part in its own frame as STEP AP214 in mm, with names and colours of its faces."""
    document = _Document()
    document.add(part, part.own_solid)
    document.write(path)


def write_assembly_step(parts: Sequence[Part], path: Path, *, name: str) -> None:
    """Write parts, where they stand, as one STEP assembly in mm with names and colours.

    Each part keeps its own frame and is placed by its location, so that a CAD program shows it as a
    component that can be moved.
    """
    if len({part.name for part in parts}) != len(parts):
        raise ValueError(f"the parts of {name} do not have names")
    document = _Document()
    assembly = document.shapes.NewShape()
    document.set_name(assembly, name)
    for part in parts:
        placed = part.solid.wrapped
        label = document.add(part, part.own_solid)
        component = document.shapes.AddComponent(assembly, label, placed.Location())
        document.set_name(component, part.name)
    document.shapes.UpdateAssemblies()
    document.write(path)


class _Document:
    """An XCAF document, filled label by label."""

    def __init__(self) -> None:
        self._document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
        self.shapes = XCAFDoc_DocumentTool.ShapeTool_s(self._document.Main())
        self._colors = XCAFDoc_DocumentTool.ColorTool_s(self._document.Main())

    def add(self, part: Part, solid: Solid) -> Any:
        """The label of ``part`` with ``solid`` in the part's own frame."""
        label = self.shapes.AddShape(solid.wrapped, False)
        self.set_name(label, part.name)
        self._set_color(label, part.color, XCAFDoc_ColorType.XCAFDoc_ColorGen)
        for face, name in zip(solid.faces(), part.face_names, strict=True):
            face_label = self.shapes.AddSubShape(label, face.wrapped)
            self.set_name(face_label, name)
            surface = XCAFDoc_ColorType.XCAFDoc_ColorSurf
            self._set_color(face_label, part.face_color(name), surface)
        return label

    def set_name(self, label: Any, name: str) -> None:
        TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))

    def _set_color(self, label: Any, color: Rgb, kind: Any) -> None:
        value = Quantity_Color(*color, Quantity_TypeOfColor.Quantity_TOC_sRGB)
        self._colors.SetColor(label, value, kind)

    def write(self, path: Path) -> None:
        for printer in Message.DefaultMessenger_s().Printers():
            printer.SetTraceLevel(Message_Gravity.Message_Fail)
        # The writer registers the settings, so it has to exist before they can be changed.
        writer = STEPCAFControl_Writer()
        if not Interface_Static.SetIVal_s("write.stepcaf.subshapes.name", 1):
            raise RuntimeError("this OCCT cannot write the names of faces to STEP")
        writer.SetNameMode(True)
        writer.SetColorMode(True)
        writer.Transfer(self._document)

        def write(file: BytesIO) -> None:
            if writer.WriteStream(file) != IFSelect_ReturnStatus.IFSelect_RetDone:
                raise InputError(f"the CAD kernel makes no STEP file of {path.stem}")

        write_by(path, write)


def write_stl(surface: LabelledSurface, path: Path, *, name: str = "gel pad") -> None:
    """Write a closed surface as binary STL in mm; STL itself names no unit."""
    corners = surface.vertices_mm[surface.triangles]
    stl.write_stl(path, corners, f"taccel_lab {name}, millimetres")


def write_part_stl(part: Part, path: Path) -> None:
    """Write one part in its own frame as binary STL in mm, to 0.01 mm."""
    labelled = LabelledSolid(part.own_solid, [Region.SIDE] * len(part.face_names))
    surface = tessellate_solid(labelled, tolerance_mm=0.01, angle_rad=0.1)
    write_stl(surface, path, name=part.name)


def write_3mf(parts: Sequence[Part], path: Path) -> None:
    """Write parts, where they stand, as bodies of one 3MF file in millimetres.

    Bodies carry the names and colours of the parts; triangles keep within 0.005 mm of
    edges, on crowned faces within 0.03 mm.
    """
    mesher = Mesher(unit=Unit.MM)
    for part in parts:
        solid = copy.copy(part.solid)
        solid.label, solid.color = part.name, Color(*part.color)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                mesher.add_shape(solid, DEVIATION_MM, ANGLE_RAD, part_number=part.name)
            except (UserWarning, RuntimeError) as error:
                raise InputError(
                    f"{part.name}: the CAD kernel gives no closed triangles for 3MF ({error})"
                ) from error
    write_by(path, lambda file: mesher.write_stream(file, "3mf"))


def write_dxf(gel: LabelledSolid, path: Path, *, others: Sequence[Part] = ()) -> None:
    """Write the gel in plan at 1:1 in mm (layers "outline", "window"), x right and y up.

    ``others`` in their places add the layer "seat" (edges of faces of that name). The section of
    the plane y = 0 lies under the plan on the layer "section", z up, its highest point
    ``SECTION_GAP_MM`` below the plan.
    """
    dxf = ExportDXF(unit=Unit.MM)
    for name, color in _LAYERS.items():
        dxf.add_layer(name, color=color)
    outline = _flat(base_outline(gel.solid))
    dxf.add_shape(outline, layer="outline")
    for edge in _own_edges(gel.faces(Region.WINDOW)):
        dxf.add_shape(_flat(edge), layer="window")
    for part in others:
        for edge in _own_edges(part.faces("seat")):
            dxf.add_shape(_flat(edge), layer="seat")
    drop = outline.bounding_box().min.Y - SECTION_GAP_MM
    for solid in (gel.solid, *(part.solid for part in others if not part.placeholder)):
        for edge in _section_edges(solid, drop):
            dxf.add_shape(edge, layer="section")
    write_by(path, dxf.write)


def _flat(shape: Edge | Wire) -> Shape:
    """A horizontal edge or wire moved to z = 0."""
    return Pos(0, 0, -shape.bounding_box().min.Z) * shape


def _own_edges(faces: Sequence[Face]) -> list[Edge]:
    """Horizontal edges that bound the faces together, without those between two of them."""
    edges = [edge for face in faces for edge in face.edges()]
    return [
        edge
        for edge in edges
        if sum(edge.is_same(other) for other in edges) == 1 and edge.bounding_box().size.Z < 1e-6
    ]


def _section_edges(solid: Solid, top_y: float) -> list[Edge]:
    """Edges of the section with y = 0, turned into the drawing plane: x right, z up."""
    turn = Location((0, top_y, 0)) * Location((0, 0, 0), (-90, 0, 0))
    return [turn * edge for face in section_faces(solid, Plane.XZ) for edge in face.edges()]
