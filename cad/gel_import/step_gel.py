# SPDX-License-Identifier: Apache-2.0
"""What the CAD kernel does with the body of a STEP file: read, checked, labelled, moved.

Runs in the readers' process, since the kernel crashes on some files.
"""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from build123d import Face, GeomType, Solid, Vector, Wire
from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
from OCP.gp import gp_Trsf

from taccel_lab.cad.gel_import.faces import FaceInfo, PartFaces
from taccel_lab.cad.gel_import.gel_checks import check_gel
from taccel_lab.cad.gel_import.importer import FaceSelection, ImportedGel
from taccel_lab.cad.gel_import.labelling import label_faces
from taccel_lab.cad.gel_import.step_checks import check_solid, chosen_body
from taccel_lab.cad.gel_import.step_reader import StepBody, read_step
from taccel_lab.cad.gel_import.units import check_units
from taccel_lab.cad.gel_import.window_cut import no_room
from taccel_lab.cad.mesh.tessellate import tessellate_solid, tessellated_faces
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.solids import imprint
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

TOLERANCE_MM, ANGLE_RAD = 0.01, 0.1
"""Tolerances of the triangles that stand for a gel's faces."""


def faces_of_step(path: Path, body: str) -> PartFaces:
    """See ``part_faces``."""
    with _kernel_errors(path):
        return _faces(chosen_body(read_step(path), path, body or None))


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
    faces = _faces(body)
    labels = label_faces(faces, selection, path, scale)
    turn = scale * labels.rotation
    moved = LabelledSolid(_transformed(solid, turn, np.zeros(3)), labels.regions)
    shift = _shift(moved) if selection.origin == "center" else np.zeros(3)
    part = LabelledSolid(_transformed(moved.solid, np.eye(3), shift), labels.regions)
    if labels.rectangle is not None:
        part = _with_window(part, labels.rectangle, path)
    surface = tessellate_solid(part, tolerance_mm=TOLERANCE_MM, angle_rad=ANGLE_RAD)
    return ImportedGel(
        part=part,
        surface=surface,
        faces=faces,
        face_regions=labels.regions,
        window_outline=labels.outline,
        min_thickness_mm=check_gel(surface, path),
        name=body.name or path.stem,
        selection=labels.selection,
        assumed=labels.assumed,
        rotation=turn,
        shift_mm=shift,
    )


def _faces(body: StepBody) -> PartFaces:
    solid = body.shape
    faces = solid.faces()
    assert isinstance(solid, Solid)
    part = LabelledSolid(solid, [Region.SIDE] * len(faces))
    vertices, triangles, face_of = tessellated_faces(
        part, tolerance_mm=TOLERANCE_MM, angle_rad=ANGLE_RAD
    )
    table = [
        FaceInfo(
            index=k,
            name=body.face_names[k],
            kind=face.geom_type.name.lower(),
            area_mm2=face.area,
            center_mm=_triple(face.position_at(0.5, 0.5)),
            normal=_triple(face.normal_at(face.position_at(0.5, 0.5))),
            color=body.face_colors[k],
        )
        for k, face in enumerate(faces)
    ]
    return PartFaces(table, vertices, triangles, face_of)


def _triple(vector: Vector) -> tuple[float, float, float]:
    # Rounded to the kernel's noise, and no negative zeros.
    return round(vector.X, 9) + 0.0, round(vector.Y, 9) + 0.0, round(vector.Z, 9) + 0.0


@contextmanager
def _kernel_errors(path: Path) -> Iterator[None]:
    """The kernel's own exceptions as a sentence about the file."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        # Its exceptions have no class in common; build123d raises the other two.
        of_kernel = type(error).__module__.startswith("OCP")
        if not of_kernel and not isinstance(error, (RuntimeError, ValueError)):
            raise
        raise InputError(
            f"{path}: the CAD kernel cannot work with its body ({type(error).__name__}: {error}); "
            "repair it in the program that it comes from"
        ) from None


def _transformed(solid: Solid, matrix: np.ndarray, shift: np.ndarray) -> Solid:
    """The solid moved by a rotation with a uniform scale and a shift, its order of faces kept."""
    move = gp_Trsf()
    rows = np.column_stack([matrix, shift])
    move.SetValues(*rows.ravel().tolist())
    return Solid(BRepBuilderAPI_Transform(solid.wrapped, move, True).Shape())


def _shift(part: LabelledSolid) -> np.ndarray:
    """Transform from the body's place to the gel frame: its middle in plan, the apex of its contact
    face."""
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
    raise no_room(path, size_mm)


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
