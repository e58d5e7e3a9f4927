# SPDX-License-Identifier: Apache-2.0
"""How good a gel mesh is and how true to its pad, and the gate before anything is simulated.

A mesh with flat tets solves without complaint and answers nonsense, so every mesh passes
``require_quality``. Distances are Hausdorff distances, sampled both ways against a fine
tessellation of the CAD solid.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cad.mesh.closest import ClosestPoint, surface_samples
from cad.mesh.quality_measures import dihedral_angles_deg, mean_ratios
from cad.mesh.surface import LabelledSurface, check_closed
from cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh

_SAMPLES = 20_000


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
    worst_tet_mm: tuple[float, float, float]
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

    def to_json(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def measure_quality(
    mesh: TetMesh,
    pad: Pad,
    *,
    cad_volume_mm3: float | None = None,
    cad_surface: LabelledSurface | None = None,
) -> MeshQuality:
    """Measure ``mesh`` against ``pad`` and, when given, against the CAD volume and surface."""
    check_closed(mesh.faces, "the boundary of the tet mesh")
    nodes = mesh.nodes_m * 1e3
    angles = dihedral_angles_deg(nodes, mesh.tets)
    smallest = angles.min(axis=1)
    ratios = mean_ratios(nodes, mesh.tets)
    edges = np.linalg.norm(nodes[mesh.faces] - nodes[np.roll(mesh.faces, 1, axis=1)], axis=-1)
    volume = float(mesh.volumes_m3().sum() * 1e9)
    contact, bonded = nodes[mesh.region_nodes(Region.CONTACT)], nodes[mesh.bonded_nodes()]
    surface = LabelledSurface(nodes, mesh.faces, mesh.face_regions)
    areas = surface.areas_mm2()
    hausdorff = rms = volume_error = None
    if cad_volume_mm3 is not None:
        volume_error = 100 * (volume / cad_volume_mm3 - 1)
    if cad_surface is not None:
        hausdorff, rms = surface_distance_mm(surface, cad_surface)
    worst = nodes[mesh.tets[int(smallest.argmin())]].mean(axis=0)
    return MeshQuality(
        node_count=mesh.node_count,
        tet_count=mesh.tet_count,
        min_dihedral_deg=float(smallest.min()),
        p1_dihedral_deg=float(np.percentile(smallest, 1)),
        max_dihedral_deg=float(angles.max()),
        min_mean_ratio=float(ratios.min()),
        mean_mean_ratio=float(ratios.mean()),
        worst_tet_mm=(float(worst[0]), float(worst[1]), float(worst[2])),
        min_edge_mm=float(edges.min()),
        max_edge_mm=float(edges.max()),
        volume_mm3=volume,
        back_plane_error_mm=float(
            np.linalg.norm(bonded - pad.bond_projection_mm(bonded), axis=1).max(initial=0)
        ),
        contact_error_mm=float(pad.contact_error_mm(contact).max(initial=0)),
        region_areas_mm2={
            r.name.lower(): float(areas[mesh.face_regions == int(r)].sum()) for r in Region
        },
        volume_error_percent=volume_error,
        hausdorff_mm=hausdorff,
        surface_rms_mm=rms,
    )


def surface_distance_mm(mesh: LabelledSurface, cad: LabelledSurface) -> tuple[float, float]:
    """Hausdorff distance of both surfaces, and rms distance of the first from the second [mm]."""
    on_mesh = surface_samples(mesh.vertices_mm, mesh.triangles, _SAMPLES)
    on_cad = surface_samples(cad.vertices_mm, cad.triangles, _SAMPLES)
    there, _ = ClosestPoint(cad.vertices_mm, cad.triangles)(on_mesh)
    back, _ = ClosestPoint(mesh.vertices_mm, mesh.triangles)(on_cad)
    spread = there[-_SAMPLES:]
    return float(max(there.max(), back.max())), float(np.sqrt((spread**2).mean()))


def require_quality(
    mesh: TetMesh,
    quality: MeshQuality,
    *,
    min_dihedral_deg: float = 2.0,
    max_volume_error_percent: float = 5.0,
    max_back_plane_error_mm: float = 1e-6,
) -> None:
    """Raise InputError, with the place in the gel frame, for a mesh unfit to be simulated."""
    if quality.min_dihedral_deg < min_dihedral_deg:
        angles = dihedral_angles_deg(mesh.nodes_m, mesh.tets).min(axis=1)
        x, y, z = quality.worst_tet_mm
        raise InputError(
            f"the mesh has {int((angles < min_dihedral_deg).sum())} of {mesh.tet_count} tets with "
            f"a dihedral angle under {min_dihedral_deg:g} deg; the worst, {angles.min():.3g} deg, "
            f"lies at x {x:.2f}, y {y:.2f}, z {z:.2f} mm"
        )
    if quality.back_plane_error_mm > max_back_plane_error_mm:
        raise InputError(
            f"a glued node lies {quality.back_plane_error_mm:.3g} mm off the back plane; allowed: "
            f"{max_back_plane_error_mm:g} mm"
        )
    error = quality.volume_error_percent
    if error is not None and abs(error) > max_volume_error_percent:
        raise InputError(
            f"the mesh volume differs from the CAD volume by {error:.2f} %; allowed: "
            f"{max_volume_error_percent:g} %. Use more rings and layers or a smaller edge"
        )
    for region in (Region.CONTACT, Region.BOND, Region.WINDOW):
        if quality.region_areas_mm2[region.name.lower()] <= 0:
            raise InputError(f"the mesh has no {region.name} faces")
