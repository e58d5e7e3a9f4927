# SPDX-License-Identifier: Apache-2.0
"""What the CAD kernel does with the body of a STEP file: read, checked, labelled, moved.

Runs in the readers' process, since the kernel crashes on some files.
"""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from build123d import Face, GeomType, Solid, Vector, Wire
from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
from OCP.gp import gp_Trsf

from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.solids import imprint
from taccel_lab.cad.step_import.checks import check_solid, check_thickness, chosen_body
from taccel_lab.cad.step_import.importer import FaceSelection, ImportedGel, right_of
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
from taccel_lab.errors import InputError, naming
from taccel_lab.geometry import Region

_NAMED: dict[str, Region] = {
    "contact": Region.CONTACT,
    "bond": Region.BOND,
    "window": Region.WINDOW,
}


def faces_of_step(path: Path, body: str) -> list[FaceInfo]:
    """See ``list_faces``."""
    with _kernel_errors(path):
        chosen = chosen_body(read_step(path), path, body or None)
        return describe_faces(chosen.shape.faces(), chosen.face_names, chosen.face_colors)


def gel_of_step(path: Path, selection: FaceSelection) -> ImportedGel:
    """See ``import_gel``."""
    with _kernel_errors(path):
        return _gel_of_step(path, selection)


def _gel_of_step(path: Path, selection: FaceSelection) -> ImportedGel:
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
    regions, rectangle = _regions(table, selection, path)
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


@contextmanager
def _kernel_errors(path: Path) -> Iterator[None]:
    """The kernel's own exceptions as a sentence about the file."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        # Its exceptions have no class of their own in common; build123d raises the other two.
        of_kernel = type(error).__module__.startswith("OCP")
        if not of_kernel and not isinstance(error, (RuntimeError, ValueError)):
            raise
        raise InputError(
            f"{path}: the CAD kernel cannot work with its body ({type(error).__name__}: {error}); "
            "repair it in the program that it comes from"
        ) from None


def _regions(
    table: Sequence[FaceInfo], selection: FaceSelection, path: Path
) -> tuple[list[Region], tuple[float, float] | None]:
    """Region of each face, and the size of the window to split off."""
    regions = [Region.SIDE] * len(table)
    rectangle = rectangle_of(selection.window)
    for name, region in _NAMED.items():
        if region == Region.WINDOW and rectangle is not None:
            continue
        with naming(path):
            chosen = select_faces(getattr(selection, name), table, name)
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
    right = selection.right or right_of(selection.normal)
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
