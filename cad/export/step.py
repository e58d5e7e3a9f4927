# SPDX-License-Identifier: Apache-2.0
"""STEP files with named and coloured faces, of one part or of an assembly."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from build123d import Solid
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Interface import Interface_Static
from OCP.Message import Message, Message_Gravity
from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.part import Part, Rgb, gel_part
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_by


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
