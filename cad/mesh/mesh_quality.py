# SPDX-License-Identifier: Apache-2.0
"""How good a gel mesh is and how true to its pad, in figures.

Distances are Hausdorff distances, sampled both ways against a fine tessellation of the CAD solid.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from taccel_lab.cad.mesh.closest import ClosestPoint, surface_samples
from taccel_lab.cad.mesh.quality_measures import TET_FACES, dihedral_angles_deg, mean_ratios
from taccel_lab.cad.mesh.surface import LabelledSurface, check_closed, doubled_areas
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.geometry import Region, TetMesh

_SAMPLES = 20_000
_CORNER_SHARE = 0.9
_STEPS_MM = np.geomspace(1e-7, 2.0, 160)
_BONDED = [int(Region.BOND), int(Region.WINDOW)]

Place = tuple[float, float, float]


@dataclass(frozen=True)
class MeshQuality:
    """Figures of one mesh; lengths in millimetres, angles in degrees."""

    node_count: int
    tet_count: int
    min_dihedral_deg: float
    """Smallest dihedral angle of all tets."""
    p1_dihedral_deg: float
    """First percentile over tets of their smallest dihedral angle."""
    max_dihedral_deg: float
    min_mean_ratio: float
    mean_mean_ratio: float
    worst_tet_mm: Place
    """Centre of the tet with the smallest dihedral angle [mm]."""
    min_edge_mm: float
    """Shortest edge of the boundary [mm]."""
    max_edge_mm: float
    """Longest edge of the boundary [mm]."""
    volume_mm3: float
    back_plane_error_mm: float
    """Greatest distance of a glued node from the surface it is glued to [mm]."""
    contact_error_mm: float
    """Greatest distance of a contact node from the formula of the contact face [mm]."""
    region_areas_mm2: dict[str, float]
    volume_error_percent: float | None = None
    """Volume against the CAD solid, negative when the mesh is smaller."""
    hausdorff_mm: float | None = None
    """Greatest distance between mesh and CAD surface, both ways [mm]."""
    surface_rms_mm: float | None = None
    """Root mean square distance of the mesh surface from the CAD surface [mm]."""
    min_volume_mm3: float = 0.0
    """Smallest signed tet volume [mm^3]."""
    back_plane_worst_mm: Place | None = None
    """The glued node farthest from the surface it is glued to."""
    hausdorff_at_mm: Place | None = None
    """Where mesh and CAD surface are farthest apart."""
    layer_volumes_mm3: tuple[float, ...] = ()
    """Volume of each material layer."""
    interface_error_mm: float | None = None
    """Greatest distance of faces between layers from where the pad's layers meet; None for one."""
    misplaced_percent: float | None = None
    """Share of the volume whose tets belong to another layer than their centre; None for one."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def measure_quality(
    mesh: TetMesh,
    pad: Pad | None,
    *,
    cad_volume_mm3: float | None = None,
    cad_surface: LabelledSurface | None = None,
) -> MeshQuality:
    """Measure ``mesh`` against ``pad`` and, when given, against the CAD volume and surface.

    Without a pad, for an imported part, glued and contact nodes are measured against the triangles
    of these regions on ``cad_surface``.
    """
    check_closed(mesh.faces, "the boundary of the tet mesh")
    nodes = mesh.nodes_m * 1e3
    angles = dihedral_angles_deg(nodes, mesh.tets)
    smallest = angles.min(axis=1)
    ratios = mean_ratios(nodes, mesh.tets)
    edges = np.linalg.norm(nodes[mesh.faces] - nodes[np.roll(mesh.faces, 1, axis=1)], axis=-1)
    volumes = mesh.volumes_m3() * 1e9
    surface = LabelledSurface(nodes, mesh.faces, mesh.face_regions)
    areas = surface.areas_mm2()
    bonded = nodes[mesh.bonded_nodes()]
    bond_errors, contact_error = _surface_errors(mesh, bonded, pad, cad_surface)
    hausdorff = rms = place = None
    if cad_surface is not None:
        hausdorff, rms, place = _surface_distance(surface, cad_surface)
    layered = pad is not None and len(pad.layer_names) > 1
    worst_bond = bonded[int(bond_errors.argmax())] if len(bond_errors) else None
    return MeshQuality(
        node_count=mesh.node_count,
        tet_count=mesh.tet_count,
        min_dihedral_deg=float(smallest.min()),
        p1_dihedral_deg=float(np.percentile(smallest, 1)),
        max_dihedral_deg=float(angles.max()),
        min_mean_ratio=float(ratios.min()),
        mean_mean_ratio=float(ratios.mean()),
        worst_tet_mm=_place(nodes[mesh.tets[int(smallest.argmin())]].mean(axis=0)),
        min_edge_mm=float(edges.min()),
        max_edge_mm=float(edges.max()),
        volume_mm3=float(volumes.sum()),
        min_volume_mm3=float(volumes.min()),
        back_plane_error_mm=float(bond_errors.max(initial=0)),
        back_plane_worst_mm=None if worst_bond is None else _place(worst_bond),
        contact_error_mm=contact_error,
        region_areas_mm2={
            r.name.lower(): float(areas[mesh.face_regions == int(r)].sum()) for r in Region
        },
        volume_error_percent=(
            None if cad_volume_mm3 is None else 100 * (float(volumes.sum()) / cad_volume_mm3 - 1)
        ),
        hausdorff_mm=hausdorff,
        hausdorff_at_mm=place,
        surface_rms_mm=rms,
        layer_volumes_mm3=tuple(np.bincount(mesh.tet_layers, volumes).tolist()),
        interface_error_mm=interface_error_mm(mesh, pad) if pad and layered else None,
        misplaced_percent=misplaced_percent(mesh, pad) if pad and layered else None,
    )


def surface_distance_mm(mesh: LabelledSurface, cad: LabelledSurface) -> tuple[float, float]:
    """Hausdorff distance of both surfaces, and rms distance of the first from the second [mm]."""
    hausdorff, rms, _ = _surface_distance(mesh, cad)
    return hausdorff, rms


def _surface_distance(mesh: LabelledSurface, cad: LabelledSurface) -> tuple[float, float, Place]:
    on_mesh = surface_samples(mesh.vertices_mm, mesh.triangles, _SAMPLES)
    on_cad = surface_samples(cad.vertices_mm, cad.triangles, _SAMPLES)
    there, _ = ClosestPoint(cad.vertices_mm, cad.triangles)(on_mesh)
    back, _ = ClosestPoint(mesh.vertices_mm, mesh.triangles)(on_cad)
    spread = there[-_SAMPLES:]
    both, points = np.concatenate([there, back]), np.concatenate([on_mesh, on_cad])
    worst = int(both.argmax())
    return float(both[worst]), float(np.sqrt((spread**2).mean())), _place(points[worst])


def _surface_errors(
    mesh: TetMesh, bonded_mm: np.ndarray, pad: Pad | None, cad: LabelledSurface | None
) -> tuple[np.ndarray, float]:
    """Distance of each glued node from its surface, and the contact face's greatest error [mm]."""
    contact = mesh.nodes_m[mesh.region_nodes(Region.CONTACT)] * 1e3
    if pad is not None:
        off = np.linalg.norm(bonded_mm - pad.bond_projection_mm(bonded_mm), axis=1)
        return off, float(pad.contact_error_mm(contact).max(initial=0))
    if cad is None:
        return np.zeros(len(bonded_mm)), 0.0
    glued = np.isin(cad.regions, _BONDED)
    touched = cad.regions == int(Region.CONTACT)
    off = np.zeros(len(bonded_mm))
    if len(bonded_mm) and glued.any():
        off, _ = ClosestPoint(cad.vertices_mm, cad.triangles[glued])(bonded_mm)
    error = 0.0
    if len(contact) and touched.any():
        distance, _ = ClosestPoint(cad.vertices_mm, cad.triangles[touched])(contact)
        error = float(distance.max())
    return off, error


def _place(point: np.ndarray) -> Place:
    return float(point[0]), float(point[1]), float(point[2])


def interface_faces(mesh: TetMesh) -> np.ndarray:
    """Triangles between tets of different layers, int32, shape [n, 3], seen from the lower one."""
    faces = mesh.tets[:, TET_FACES].reshape(-1, 3)
    layers = np.repeat(mesh.tet_layers, 4)
    order = np.lexsort(np.sort(faces, axis=1).T)
    ordered = np.sort(faces, axis=1)[order]
    pair = np.flatnonzero((ordered[1:] == ordered[:-1]).all(axis=1))
    first, second = order[pair], order[pair + 1]
    differ = layers[first] != layers[second]
    first, second = first[differ], second[differ]
    return faces[np.where(layers[first] < layers[second], first, second)]


def interface_error_mm(mesh: TetMesh, pad: Pad) -> float:
    """Greatest distance of the mesh's interface from the pad's, along the face normals [mm].

    The pad only says which layer a point belongs to: each face's normal is followed both ways until
    the layer changes. 2 mm, the end of the search, where the pad has no interface; 0 for a mesh
    without interface.
    """
    faces = interface_faces(mesh)
    if not len(faces):
        return 0.0
    corners = mesh.nodes_m[faces] * 1e3
    normals = doubled_areas(corners)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    center = corners.mean(axis=1, keepdims=True)
    # A little inside the face: its corners may lie on the outside of the body.
    near = center + _CORNER_SHARE * (corners - center)
    points = np.concatenate([center, near], axis=1).reshape(-1, 3)
    along = np.repeat(normals, 4, axis=0)
    error = np.full(len(points), _STEPS_MM[-1])
    open_ = np.arange(len(points))
    for step in _STEPS_MM:
        p, n = points[open_], step * along[open_]
        crossed = pad.layer_of(p + n) != pad.layer_of(p - n)
        error[open_[crossed]] = step
        open_ = open_[~crossed]
        if not len(open_):
            break
    return float(error.max())


def misplaced_percent(mesh: TetMesh, pad: Pad) -> float:
    """Share of the volume in tets whose centre belongs to another layer than they do [%]."""
    volumes = mesh.volumes_m3()
    centers = mesh.nodes_m[mesh.tets].mean(axis=1) * 1e3
    wrong = pad.layer_of(centers) != mesh.tet_layers
    return float(100 * volumes[wrong].sum() / volumes.sum())
