# SPDX-License-Identifier: Apache-2.0
"""Bodies of a STEP file with the names and colours of their faces."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false, reportMissingImports=false

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from build123d import Shell, Solid
from build123d.topology import Shape
from OCP.collections import Sequence_TDF_Label
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Interface import Interface_Static
from OCP.Message import Message, Message_Gravity
from OCP.Quantity import Quantity_Color
from OCP.STEPCAFControl import STEPCAFControl_Reader
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_Label
from OCP.TDocStd import TDocStd_Document
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

from taccel_lab.errors import InputError


@dataclass(frozen=True)
class StepBody:
    """One solid or shell of a STEP file, where the file puts it, in millimetres."""

    name: str
    shape: Shape
    face_names: tuple[str, ...]
    """Names in the order of ``shape.faces()``; "" where the file has none."""
    face_colors: tuple[str, ...]
    """"rrggbb" of each face, sRGB; "" where the file has none."""

    @property
    def is_solid(self) -> bool:
        """False for a shell, which encloses nothing."""
        return isinstance(self.shape, Solid)


def read_step(path: Path | str) -> list[StepBody]:
    """All solids of a STEP file, and shells that are part of none; lengths in millimetres.

    Lengths are converted from the unit that the file declares. Raises InputError when the file
    cannot be read or holds no body.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist or is no file")
    for printer in Message.DefaultMessenger_s().Printers():
        printer.SetTraceLevel(Message_Gravity.Message_Fail)
    # The reader registers the settings, so it has to exist before they can be changed.
    reader = STEPCAFControl_Reader()
    if not Interface_Static.SetIVal_s("read.stepcaf.subshapes.name", 1):
        raise RuntimeError("this OCCT cannot read the names of faces from STEP")
    reader.SetNameMode(True)
    reader.SetColorMode(True)
    document = TDocStd_Document(TCollection_ExtendedString("XCAF"))
    status = reader.ReadFile(str(path))
    if status != IFSelect_ReturnStatus.IFSelect_RetDone or not reader.Transfer(document):
        raise InputError(f"{path} is not a STEP file that the CAD kernel can read")
    bodies = _Walk(document).bodies
    if not bodies:
        raise InputError(f"{path} holds neither a solid nor a shell")
    return bodies


class _Walk:
    """Goes through the labels of a document, down the assemblies."""

    def __init__(self, document: TDocStd_Document) -> None:
        self._shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
        self._colors = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
        self.bodies: list[StepBody] = []
        free = Sequence_TDF_Label()
        self._shapes.GetFreeShapes(free)
        for label in _labels(free):
            self._visit(label, None, _name(label))

    def _visit(self, label: TDF_Label, location: Any, name: str) -> None:
        target = label
        if self._shapes.IsReference_s(label):
            target = TDF_Label()
            self._shapes.GetReferredShape_s(label, target)
            here = self._shapes.GetLocation_s(label)
            location = here if location is None else location.Multiplied(here)
            name = _name(target) or name
        if self._shapes.IsAssembly_s(target):
            parts = Sequence_TDF_Label()
            self._shapes.GetComponents_s(target, parts)
            for part in _labels(parts):
                self._visit(part, location, _name(part))
            return
        self._collect(target, location, name)

    def _collect(self, label: TDF_Label, location: Any, name: str) -> None:
        whole = Shape.cast(self._shapes.GetShape_s(label))
        found = list(whole.solids()) or list(whole.shells())
        named = Sequence_TDF_Label()
        self._shapes.GetSubShapes_s(label, named)
        labels = [(self._shapes.GetShape_s(sub), _name(sub)) for sub in _labels(named)]
        for body in found:
            faces = body.faces()
            names = [
                next((n for shape, n in labels if shape.IsSame(face.wrapped)), "") for face in faces
            ]
            colors = tuple(self._color(face.wrapped) for face in faces)
            placed = body.wrapped if location is None else body.wrapped.Moved(location)
            shape = Solid(placed) if isinstance(body, Solid) else Shell(placed)
            self.bodies.append(StepBody(name, shape, tuple(names), colors))

    def _color(self, face: Any) -> str:
        value = Quantity_Color()
        for kind in (XCAFDoc_ColorType.XCAFDoc_ColorSurf, XCAFDoc_ColorType.XCAFDoc_ColorGen):
            if self._colors.GetColor(face, kind, value):
                return Quantity_Color.ColorToHex_s(value).ToCString().lstrip("#").lower()
        return ""


def _labels(sequence: Sequence_TDF_Label) -> list[TDF_Label]:
    return [sequence.Value(k + 1) for k in range(sequence.Length())]


def _name(label: TDF_Label) -> str:
    # Asked first: FindAttribute of a label without one crashes in OCP 8.0 (build123d #1433). Faces
    # of a part that an assembly places twice have none.
    name = TDataStd_Name()
    if not label.IsAttribute(TDataStd_Name.GetID_s()):
        return ""
    label.FindAttribute(TDataStd_Name.GetID_s(), name)
    return str(name.Get().ToExtString())
