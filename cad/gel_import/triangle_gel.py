# SPDX-License-Identifier: Apache-2.0
"""Gels from triangles and tets: one body, closed, clean, labelled and moved to the gel frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from taccel_lab.bodies.mesh_checks import check_surface
from taccel_lab.cad.gel_import.gel_checks import check_gel, check_units, no_room
from taccel_lab.cad.gel_import.importer import FaceSelection, ImportedGel, PartFaces
from taccel_lab.cad.gel_import.labelling import Labelling, center_shift, label_faces
from taccel_lab.cad.gel_import.patches import faces_of_triangles
from taccel_lab.cad.mesh.repair import RepairedSurface, repair_surface
from taccel_lab.cad.mesh.surface import LabelledSurface, doubled_areas, enclosed_volume
from taccel_lab.errors import InputError
from taccel_lab.files.apart import LIMIT_S, read_apart
from taccel_lab.files.tet_file import read_tet_file
from taccel_lab.files.triangle_file import read_triangle_file
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.connectivity import compacted, piece_of_cells
from taccel_lab.geometry.tet_mesh import boundary_faces, tet_volumes

MAX_TRIANGLES = 50_000
"""Most triangles of a gel's surface; fTetWild takes minutes for it."""
_DEBRIS_SHARE = 0.01
"""Pieces with less than this share of the area are no bodies; repair cuts them out."""
_MOST_PIECES = 1000
"""Loose pieces that are measured."""
_LEVEL_MM = 1e-6
_ON_LINE_MM = 1e-6


@dataclass(frozen=True)
class _Body:
    """One body of a file, in millimetres, outward."""

    points: np.ndarray
    triangles: np.ndarray
    scale: float
    """Millimetres of a unit of the file."""
    tets: np.ndarray | None = None
    notes: dict[str, str] = field(default_factory=dict)
    """What was done to it."""


def faces_of_cells(path: Path, kind: str, body: str, unit: str) -> PartFaces:
    """Numbered faces of the body of a file [mm]; ``kind``: whether it holds triangles or tets."""
    found = _read(path, kind, body, unit)
    return faces_of_triangles(found.points, found.triangles)


def gel_of_cells(path: Path, kind: str, selection: FaceSelection) -> ImportedGel:
    """See ``import_gel``; ``kind`` as of ``faces_of_cells``."""
    body = _read(path, kind, selection.body, selection.unit)
    faces = faces_of_triangles(body.points, body.triangles)
    labels = label_faces(faces, selection)
    regions = np.array([int(r) for r in labels.regions], dtype=np.int32)[faces.face_of]
    points = body.points @ labels.rotation.T
    shift = np.zeros(3)
    if selection.origin == "center":
        shift = center_shift(points, body.triangles, regions == int(Region.CONTACT))
    whole = LabelledSurface(points + shift, body.triangles, regions)
    surface = whole
    if labels.rectangle is not None:
        surface = with_window(whole, labels.rectangle)
    assumed = {**labels.assumed, **body.notes}
    if "unit" in assumed:
        assumed["unit"] = "the numbers are millimetres"
    return ImportedGel(
        surface=surface,
        faces=faces,
        face_regions=labels.regions,
        window_outline=labels.outline,
        min_thickness_mm=check_gel(surface),
        name=path.stem,
        selection=labels.selection,
        assumed=assumed,
        rotation=body.scale * labels.rotation,
        shift_mm=shift,
        mesh=None if body.tets is None else _mesh(whole, body.tets, labels),
    )


def _mesh(surface: LabelledSurface, tets: np.ndarray, labels: Labelling) -> TetMesh | None:
    """The file's own tets; a rectangle takes the triangles whose middles lie in it."""
    regions = surface.regions.copy()
    if labels.rectangle is not None:
        middles = surface.vertices_mm[surface.triangles].mean(axis=1)
        inside = (np.abs(middles[:, :2]) < np.array(labels.rectangle) / 2).all(axis=1)
        regions[inside & (regions == int(Region.BOND))] = int(Region.WINDOW)
    try:
        return TetMesh(1e-3 * surface.vertices_mm, tets, surface.triangles, regions)
    except InputError:  # Flat tets: they are made anew.
        return None


def _read(path: Path, kind: str, body: str, unit: str) -> _Body:
    if kind == "tets":
        return _of_tets(*read_tet_file(path), body, unit)
    return _clean(path, *read_triangle_file(path), body, unit)


def _of_tets(nodes: np.ndarray, tets: np.ndarray, body: str, unit: str) -> _Body:
    scale = _scale(nodes, unit)
    tets = _piece(tets, body, lambda part: np.abs(tet_volumes(scale * nodes, part)).sum())
    used, tets = compacted(tets)
    points = scale * nodes[used]
    try:
        triangles = boundary_faces(tets)
        used, packed = compacted(triangles)
        check_surface(points[used], packed, "its surface", closed=True)
    except InputError as error:
        raise InputError(f"{error}; mesh the part again") from None
    return _Body(points, triangles, scale, tets.astype(np.int32))


def _clean(path: Path, points: np.ndarray, triangles: np.ndarray, body: str, unit: str) -> _Body:
    """One closed, outward body; what pymeshlab can mend is mended, and noted."""
    scale = _scale(points, unit)
    points = scale * points

    def volume(part: np.ndarray) -> float:
        corners = points[part]
        return abs(enclosed_volume(corners - corners.mean(axis=(0, 1))))

    triangles = _piece(triangles, body, volume)
    if len(triangles) > MAX_TRIANGLES:
        raise InputError(
            f"the body has {len(triangles):,} triangles; a gel may have up to "
            f"{MAX_TRIANGLES:,}: simplify it"
        )
    used, triangles = compacted(triangles)
    points, triangles = points[used], triangles.astype(np.int32)
    notes: dict[str, str] = {}
    try:
        check_surface(points, triangles, "its surface", closed=True)
    except InputError as fault:
        try:
            mended = read_apart(
                str(path), repair_surface, points, triangles, by="pymeshlab", limit_s=LIMIT_S,
                records=lambda: (RepairedSurface,),
            )  # fmt: skip
        except InputError as error:
            raise InputError(f"{fault}. Mending it fails: {error}") from None
        points, triangles = mended.vertices, mended.triangles
        notes["repair"] = "; ".join(mended.actions)
    if enclosed_volume(points[triangles]) < 0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
        notes["inside out"] = "all triangles faced inward and were turned"
    return _Body(points, triangles, scale, notes=notes)


def _scale(points: np.ndarray, unit: str) -> float:
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    return check_units(bounds, unit or None, what="the part")


def _piece(cells: np.ndarray, body: str, volume: Callable[[np.ndarray], float]) -> np.ndarray:
    """The cells of the only connected piece of size, or of the one of a number, from 1."""
    piece = piece_of_cells(cells)
    if piece.max() == 0 and not body:
        return cells
    measured = range(min(piece.max() + 1, _MOST_PIECES))
    volumes = np.array([volume(cells[piece == k]) for k in measured])
    large = np.flatnonzero(volumes >= _DEBRIS_SHARE * volumes.max())
    order = large[np.argsort(-volumes[large], kind="stable")]
    if body.isdecimal() and 1 <= int(body) <= len(order):
        return cells[piece == order[int(body) - 1]]
    if len(order) == 1 and not body:
        return cells[piece == order[0]]
    words = ", ".join(f"{n} ({volumes[k]:.1f} mm^3)" for n, k in enumerate(order[:20], 1))
    raise InputError(
        f"it holds {len(order)} bodies{f', none of the number {body!r}' if body else ''}; one "
        f"is needed. There are: {words}. Say which one with --body, or export the gel alone"
    )


def with_window(surface: LabelledSurface, size_mm: tuple[float, float]) -> LabelledSurface:
    """The surface with a rectangle about the origin of plan [mm] as its window; bond triangles are
    cut along its sides, and so are those that they share edges with.

    Raises InputError when no level bond triangles fill the rectangle.
    """
    half = np.array(size_mm) / 2
    for axis in range(2):
        for side in (-half[axis], half[axis]):
            surface = _cut_level_bond(surface, axis, float(side))
    corners = surface.vertices_mm[surface.triangles]
    middles = corners.mean(axis=1)
    inside = _level_bond(surface) & (np.abs(middles[:, :2]) < half).all(axis=1)
    area = 0.5 * np.linalg.norm(doubled_areas(corners[inside]), axis=1).sum()
    if abs(area - size_mm[0] * size_mm[1]) > 1e-4 * size_mm[0] * size_mm[1]:
        raise no_room(size_mm)
    regions = surface.regions.copy()
    regions[inside] = int(Region.WINDOW)
    return LabelledSurface(surface.vertices_mm, surface.triangles, regions)


def without_window(surface: LabelledSurface) -> LabelledSurface:
    """The surface with its window as bond."""
    regions = surface.regions.copy()
    regions[regions == int(Region.WINDOW)] = int(Region.BOND)
    return LabelledSurface(surface.vertices_mm, surface.triangles, regions)


def _level_bond(surface: LabelledSurface) -> np.ndarray:
    heights = surface.vertices_mm[surface.triangles][..., 2]
    return (surface.regions == int(Region.BOND)) & (np.ptp(heights, axis=1) < _LEVEL_MM)


def _cut_level_bond(surface: LabelledSurface, axis: int, at_mm: float) -> LabelledSurface:
    """Level bond triangles cut where a coordinate has a value."""
    points, triangles = surface.vertices_mm, surface.triangles.astype(np.int64)
    away = points[:, axis] - at_mm
    away = np.where(np.abs(away) < _ON_LINE_MM, 0.0, away)
    bond = triangles[_level_bond(surface)]
    edges = np.unique(np.sort(bond[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    edges = edges[away[edges[:, 0]] * away[edges[:, 1]] < 0]
    if not len(edges):
        return surface
    start, end = away[edges].T
    share = (start / (start - end))[:, None]
    cuts = points[edges[:, 0]] * (1 - share) + points[edges[:, 1]] * share
    cuts[:, axis] = at_mm
    middle = {(int(a), int(b)): len(points) + k for k, (a, b) in enumerate(edges)}
    kept, pieces, labels = [], [], []
    for triangle, region in zip(triangles.tolist(), surface.regions.tolist(), strict=True):
        whole = [triangle]
        for pair, cut in ((_pair(triangle, k), k) for k in range(3)):
            if pair in middle:
                whole = _halved(whole, triangle[cut], triangle[(cut + 1) % 3], middle[pair])
        (pieces if len(whole) > 1 else kept).extend(whole)
        labels.append((region, len(whole)))
    regions = [r for r, n in labels if n == 1] + [r for r, n in labels if n > 1 for _ in range(n)]
    return LabelledSurface(
        np.concatenate([points, cuts]),
        np.array(kept + pieces, dtype=np.int32),
        np.array(regions, dtype=np.int32),
    )


def _pair(triangle: list[int], k: int) -> tuple[int, int]:
    a, b = triangle[k], triangle[(k + 1) % 3]
    return min(a, b), max(a, b)


def _halved(whole: list[list[int]], start: int, end: int, middle: int) -> list[list[int]]:
    """Triangles cut at the middle of the one edge from ``start`` to ``end``."""
    found = []
    for triangle in whole:
        for k in range(3):
            if triangle[k] == start and triangle[(k + 1) % 3] == end:
                apex = triangle[(k + 2) % 3]
                found += [[start, middle, apex], [middle, end, apex]]
                break
        else:
            found.append(triangle)
    return found
