# SPDX-License-Identifier: Apache-2.0
"""What the CAD kernel does with a stranger's body: of STEP read, checked, labelled, moved; of
triangles made into a solid.

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
from OCP.BOPAlgo import BOPAlgo_CheckStatus
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAlgoAPI import BRepAlgoAPI_Check
from OCP.BRepBuilderAPI import (
    BRepBuilderAPI_MakeEdge,
    BRepBuilderAPI_MakeFace,
    BRepBuilderAPI_MakeVertex,
    BRepBuilderAPI_MakeWire,
    BRepBuilderAPI_Transform,
)
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.gp import gp_Dir, gp_Pln, gp_Pnt, gp_Trsf
from OCP.ShapeUpgrade import ShapeUpgrade_UnifySameDomain
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Shell, TopoDS_Solid

from taccel_lab.cad.gel_import.gel_checks import check_gel, check_units, no_room
from taccel_lab.cad.gel_import.importer import (
    FaceInfo,
    FaceSelection,
    ImportedGel,
    PartFaces,
    triple,
)
from taccel_lab.cad.gel_import.labelling import label_faces
from taccel_lab.cad.gel_import.step_reader import StepBody, read_step
from taccel_lab.cad.mesh.closest import ClosestPoint
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.mesh.tessellate import tessellate_solid, tessellated_faces
from taccel_lab.cad.parts.part import LabelledSolid
from taccel_lab.cad.parts.solids import imprint
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

TOLERANCE_MM, ANGLE_RAD = 0.01, 0.1
"""Tolerances of the triangles that stand for a gel's faces."""
_LISTED = 40
"""Solids that a message names."""
_SAME_VOLUME = 1e-4


@contextmanager
def _kernel_errors() -> Iterator[None]:
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
            f"the CAD kernel cannot work with its body ({type(error).__name__}: {error}); "
            "repair it in the program that it comes from"
        ) from None


@_kernel_errors()
def faces_of_step(path: Path, body: str) -> PartFaces:
    """See ``part_faces``."""
    return _faces(chosen_body(read_step(path), body or None))


@_kernel_errors()
def gel_of_step(path: Path, selection: FaceSelection) -> ImportedGel:
    """See ``import_gel``."""
    bodies = read_step(path)
    body = chosen_body(bodies, selection.body or None)
    solid = body.shape
    assert isinstance(solid, Solid)
    box = solid.bounding_box()
    bounds = np.array([tuple(box.min), tuple(box.max)])
    scale = check_units(bounds, selection.unit or None, what="the solid")
    check_solid(solid)
    faces = _faces(body)
    labels = label_faces(faces, selection, scale)
    turn = scale * labels.rotation
    moved = LabelledSolid(_transformed(solid, turn, np.zeros(3)), labels.regions)
    shift = _shift(moved) if selection.origin == "center" else np.zeros(3)
    part = LabelledSolid(_transformed(moved.solid, np.eye(3), shift), labels.regions)
    if labels.rectangle is not None:
        part = _with_window(part, labels.rectangle)
    surface = tessellate_solid(part, tolerance_mm=TOLERANCE_MM, angle_rad=ANGLE_RAD)
    return ImportedGel(
        part=part,
        surface=surface,
        faces=faces,
        face_regions=labels.regions,
        window_outline=labels.outline,
        min_thickness_mm=check_gel(surface),
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
            center_mm=triple(face.position_at(0.5, 0.5)),
            normal=triple(face.normal_at(face.position_at(0.5, 0.5))),
            color=body.face_colors[k],
        )
        for k, face in enumerate(faces)
    ]
    return PartFaces(table, vertices, triangles, face_of)


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


def _with_window(part: LabelledSolid, size_mm: tuple[float, float]) -> LabelledSolid:
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
    raise no_room(size_mm)


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


def chosen_body(bodies: Sequence[StepBody], name: str | None) -> StepBody:
    """The only solid of a file, or the one of a name, or of a number, from 1, where no solid has
    that name."""
    solids = [body for body in bodies if body.is_solid]
    if not solids:
        count = sum(_open_edges(body) for body in bodies)
        state = f"open at {count} edges. Close it and export" if count else "closed. Export"
        if not any(body.shape.faces() for body in bodies):
            state = "empty. Export"
        raise InputError(
            f"it holds {len(bodies)} shell(s) but no solid: the surface is {state} a solid"
        )
    words = ", ".join(
        f"{number} {body.name or 'without a name'} ({body.shape.volume:.1f} mm^3)"
        for number, body in enumerate(solids[:_LISTED], 1)
    ) + (f" and {len(solids) - _LISTED} more" if len(solids) > _LISTED else "")
    if name is not None:
        numbered = {str(number): [body] for number, body in enumerate(solids, 1)}
        named = [body for body in solids if body.name == name]
        solids = named or numbered.get(name, [])
    if len(solids) == 1:
        return solids[0]
    wanted = f" of the name {name!r}" if name is not None else ""
    raise InputError(
        f"it holds {len(solids)} solids{wanted}; one is needed. There are: {words}. Say which "
        "one with --body, by name or number, or export the gel alone"
    )


def _open_edges(body: StepBody) -> int:
    faces = body.shape.faces()
    edges = [edge for face in faces for edge in face.edges()]
    return sum(sum(edge.is_same(other) for other in edges) == 1 for edge in edges)


def check_solid(solid: Solid) -> None:
    """Raise InputError for an open, invalid, inside-out or self-intersecting solid."""
    for shell in solid.shells():
        if not BRep_Tool.IsClosed_s(shell.wrapped):
            raise InputError("the solid's shell is open, so that it is not watertight")
    # The first two arguments after the shape: no test for small edges, one for self-interference.
    found = BRepAlgoAPI_Check(solid.wrapped, False, True)
    crossings = sum(
        result.GetCheckStatus() == BOPAlgo_CheckStatus.BOPAlgo_SelfIntersect
        for result in found.Result()
    )
    if crossings:
        raise InputError(
            f"the solid intersects itself in {crossings} places; repair it in the program "
            "that it comes from"
        )
    if not BRepCheck_Analyzer(solid.wrapped).IsValid():
        bad = [
            k
            for k, face in enumerate(solid.faces())
            if not BRepCheck_Analyzer(face.wrapped).IsValid()
        ]
        where = f" (faces {', '.join(map(str, bad[:10]))})" if bad else ""
        raise InputError(
            f"the CAD kernel finds the solid invalid{where}; repair it in the program that "
            "it comes from"
        )
    if solid.volume <= 0:
        raise InputError(f"the solid has a volume of {solid.volume:.3g} mm^3")


def facet_solid(surface: LabelledSurface) -> LabelledSolid:
    """The solid in ``surface``, for moulds and drawings; neighbours in a plane and of a region
    become one face.

    Raises InputError when the kernel makes another volume of it.
    """
    vertices = [
        BRepBuilderAPI_MakeVertex(gp_Pnt(*p)).Vertex() for p in surface.vertices_mm.tolist()
    ]
    edges: dict[tuple[int, int], tuple[TopoDS_Edge, set[int]]] = {}
    builder, shell = BRep_Builder(), TopoDS_Shell()
    builder.MakeShell(shell)
    corners = surface.vertices_mm[surface.triangles]
    for triangle, region, at, normal in zip(
        surface.triangles.tolist(), surface.regions.tolist(), corners[:, 0], surface.normals(),
        strict=True,
    ):  # fmt: skip
        wire = BRepBuilderAPI_MakeWire()
        for a, b in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            pair = (min(a, b), max(a, b))
            if pair not in edges:
                made = BRepBuilderAPI_MakeEdge(vertices[pair[0]], vertices[pair[1]]).Edge()
                edges[pair] = made, set()
            edge, regions = edges[pair]
            regions.add(region)
            wire.Add(edge if a < b else TopoDS.Edge(edge.Reversed()))
        plane = gp_Pln(gp_Pnt(*at.tolist()), gp_Dir(*normal.tolist()))
        builder.Add(shell, BRepBuilderAPI_MakeFace(plane, wire.Wire(), True).Face())
    shell.Closed(True)
    solid = TopoDS_Solid()
    builder.MakeSolid(solid)
    builder.Add(solid, shell)
    merge = ShapeUpgrade_UnifySameDomain(solid, True, True, False)
    for edge, regions in edges.values():
        if len(regions) > 1:
            merge.KeepShape(edge)
    merge.Build()
    found = Solid(merge.Shape())
    part = LabelledSolid(found, _regions(found, surface))
    wanted = surface.volume_mm3()
    if abs(part.volume_mm3 - wanted) > _SAME_VOLUME * wanted:
        raise InputError(
            f"the CAD kernel makes a solid of {part.volume_mm3:.4g} mm^3 of triangles around "
            f"{wanted:.4g} mm^3"
        )
    return part


def _regions(solid: Solid, surface: LabelledSurface) -> list[Region]:
    """Region of each face: that of the triangles under its own largest one."""
    bare = LabelledSolid(solid, [Region.SIDE] * len(solid.faces()))
    points, triangles, face_of = tessellated_faces(
        bare, tolerance_mm=TOLERANCE_MM, angle_rad=ANGLE_RAD
    )
    corners = points[triangles]
    areas = LabelledSurface(points, triangles, face_of).areas_mm2()
    largest = np.array([
        np.flatnonzero(face_of == k)[areas[face_of == k].argmax()] for k in range(len(bare.regions))
    ])  # fmt: skip
    _, cells = ClosestPoint(surface.vertices_mm, surface.triangles)(corners[largest].mean(axis=1))
    return [Region(int(region)) for region in surface.regions[cells]]
