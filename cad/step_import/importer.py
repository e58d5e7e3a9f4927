# SPDX-License-Identifier: Apache-2.0
"""A user's own gel from a STEP file: checked, faces selected, moved into the gel frame."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from build123d import Face, GeomType, Solid, Vector, Wire
from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
from OCP.gp import gp_Trsf
from pydantic import BeforeValidator, StrictStr

from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.solids import imprint
from taccel_lab.cad.step_import.checks import check_solid, check_thickness, chosen_body
from taccel_lab.cad.step_import.reader import read_step
from taccel_lab.cad.step_import.selection import (
    FaceInfo,
    describe_faces,
    direction,
    listing,
    rectangle_of,
    select_faces,
)
from taccel_lab.cad.step_import.units import check_units
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.reading.strict_model import StrictModel

_NAMED: dict[str, Region] = {
    "contact": Region.CONTACT,
    "bond": Region.BOND,
    "window": Region.WINDOW,
}
_ORIGINS = ("center", "file")


def _as_tuple(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


Selectors = Annotated[tuple[StrictStr, ...], BeforeValidator(_as_tuple)]
"""One or several; text stands for one."""


class FaceSelection(StrictModel):
    """Which faces are what, and how the body lies in its file; see ``selection`` for the words."""

    contact: Selectors = ("name:contact",)
    bond: Selectors = ("name:bond",)
    window: Selectors = ("name:window",)
    normal: str = "+z"
    """Direction of the file that points out of the gel."""
    right: str = ""
    """Direction of the file that becomes the gel's x; +x, or +y for a normal along x, if empty."""
    origin: str = "center"
    """"center": the middle of the body in plan at the height of the apex; "file": as it is."""
    body: str = ""
    """Name of the solid in a file with several."""
    unit: str = ""
    """Unit of the numbers as read; millimetres, checked for plausibility, if empty."""

    @classmethod
    def from_toml(cls, path: Path | None) -> FaceSelection:
        """Read the fields as keys of a TOML file; the defaults without a file.

        Raises InputError with every key that is unknown or wrong.
        """
        return cls() if path is None else cls.read(path)


@dataclass(frozen=True)
class ImportedGel:
    """A gel read from a file, in the gel frame."""

    part: LabelledSolid
    surface: LabelledSurface
    """Closed triangles of the part."""
    faces: list[FaceInfo] = field(repr=False)
    """The faces as the file has them."""
    min_thickness_mm: float
    name: str
    rotation: np.ndarray
    """Gel from file: a point p of the file [mm] lies at ``rotation @ p + shift_mm``, [3, 3]."""
    shift_mm: np.ndarray

    @property
    def thickness_mm(self) -> float:
        """Gel between the highest contact point and the highest glued point under it [mm]."""
        z = self.surface.vertices_mm[:, 2]
        glued = np.isin(self.surface.regions, [int(Region.BOND), int(Region.WINDOW)])
        top = z[self.surface.triangles[self.surface.regions == int(Region.CONTACT)]].max()
        return float(top - z[self.surface.triangles[glued]].max())


def list_faces(path: Path | str, body: str = "") -> list[FaceInfo]:
    """Faces of the solid in a STEP file, numbered, in the file's own frame [mm]."""
    chosen = chosen_body(read_step(path), Path(path), body or None)
    return describe_faces(chosen.shape.faces(), chosen.face_names, chosen.face_colors)


def import_gel(path: Path | str, selection: FaceSelection | None = None) -> ImportedGel:
    """Read, check and label a gel.

    Raises InputError for a file without exactly one closed, clean solid of a gel's size, and for
    selectors that choose nothing, overlap or leave a region empty; the message lists the faces.
    """
    path, selection = Path(path), selection or FaceSelection()
    if selection.origin not in _ORIGINS:
        raise InputError(f"origin {selection.origin!r} is not allowed; use {' or '.join(_ORIGINS)}")
    bodies = read_step(path)
    body = chosen_body(bodies, path, selection.body or None)
    solid = body.shape
    assert isinstance(solid, Solid)
    box = solid.bounding_box()
    bounds = np.array([tuple(box.min), tuple(box.max)])
    scale = check_units(bounds, selection.unit or None, what=f"{path}: the solid")
    check_solid(solid, path)
    table = describe_faces(solid.faces(), body.face_names, body.face_colors)
    rotation = _rotation(selection)
    regions, rectangle = _regions(solid, table, selection, path)
    moved = LabelledSolid(_transformed(solid, scale * rotation, np.zeros(3)), regions)
    shift = _shift(moved) if selection.origin == "center" else np.zeros(3)
    part = LabelledSolid(_transformed(moved.solid, np.eye(3), shift), regions)
    if rectangle is not None:
        part = _with_window(part, rectangle, path)
    surface = tessellate_solid(part, tolerance_mm=0.01, angle_rad=0.1)
    return ImportedGel(
        part=part,
        surface=surface,
        faces=table,
        min_thickness_mm=check_thickness(surface, path),
        name=body.name or path.stem,
        rotation=scale * rotation,
        shift_mm=shift,
    )


def _regions(
    solid: Solid, table: Sequence[FaceInfo], selection: FaceSelection, path: Path
) -> tuple[list[Region], tuple[float, float] | None]:
    """Region of each face, and the size of the window to split off."""
    faces = solid.faces()
    regions = [Region.SIDE] * len(faces)
    rectangle = rectangle_of(selection.window)
    for name, region in _NAMED.items():
        if region == Region.WINDOW and rectangle is not None:
            continue
        try:
            chosen = select_faces(getattr(selection, name), faces, table, name)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        if not chosen:
            raise InputError(f"{path}: no faces are selected for {name}\n{listing(table)}")
        for index in sorted(chosen):
            if regions[index] != Region.SIDE:
                raise InputError(
                    f"{path}: face {index} is selected for {regions[index].name.lower()} and for "
                    f"{name}\n{listing(table)}"
                )
            regions[index] = region
    return regions, rectangle


def _rotation(selection: FaceSelection) -> np.ndarray:
    """Gel from file: z along ``normal``, x along ``right``."""
    z = direction(selection.normal)
    right = selection.right or ("+y" if abs(z[0]) > 0.5 else "+x")
    x = direction(right)
    if abs(float(x @ z)) > 0.5:
        raise InputError(f"right = {right} lies along normal = {selection.normal}; name another")
    return np.stack([x, np.cross(z, x), z])


def _transformed(solid: Solid, matrix: np.ndarray, shift: np.ndarray) -> Solid:
    """The solid moved by a rotation with a uniform scale and a shift, its order of faces kept."""
    move = gp_Trsf()
    rows = np.column_stack([matrix, shift])
    move.SetValues(*rows.ravel().tolist())
    return Solid(BRepBuilderAPI_Transform(solid.wrapped, move, True).Shape())


def _shift(part: LabelledSolid) -> np.ndarray:
    """From the body's place to the gel frame: its middle in plan, the apex of its contact face."""
    box = part.solid.bounding_box()
    apex = max(face.bounding_box().max.Z for face in part.faces(Region.CONTACT))
    return -np.array([(box.min.X + box.max.X) / 2, (box.min.Y + box.max.Y) / 2, apex])


def _with_window(part: LabelledSolid, size_mm: tuple[float, float], path: Path) -> LabelledSolid:
    """Split a rectangle in the middle of the glued plane off as the window."""
    bond = [
        (k, face)
        for k, (face, region) in enumerate(zip(part.solid.faces(), part.regions, strict=True))
        if region == Region.BOND and face.geom_type == GeomType.PLANE
    ]
    x, y = size_mm[0] / 2, size_mm[1] / 2
    for _, face in bond:
        z = face.center().Z
        corners = [(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)]
        level = face.bounding_box().size.Z < 1e-6
        if level and all(face.is_inside(Vector(*c), 1e-6) for c in corners):
            return _split(part, face, Wire.make_polygon(corners, close=True))
    raise InputError(
        f"{path}: no plane bond face, square to the normal, takes a window of {size_mm[0]:g} x "
        f"{size_mm[1]:g} mm in its middle; choose a smaller one or select window faces"
    )


def _split(part: LabelledSolid, face: Face, wire: Wire) -> LabelledSolid:
    solid = imprint(part.solid, face, wire)
    old = list(zip(part.solid.faces(), part.regions, strict=True))
    regions = []
    for new in solid.faces():
        same = [region for earlier, region in old if earlier.is_same(new)]
        if same:
            regions.append(same[0])
        else:
            inner = new.distance_to(Vector(0, 0, face.center().Z)) < 1e-9 and not new.inner_wires()
            regions.append(Region.WINDOW if inner else Region.BOND)
    return LabelledSolid(solid, regions)
