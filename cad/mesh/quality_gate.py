# SPDX-License-Identifier: Apache-2.0
"""The gate that every mesh passes before anything is simulated on it.

A mesh with flat tets solves without complaint and answers nonsense, and one whose surface is off
answers for another pad. The gate names every limit that a mesh breaks, by how much and where.

The limits hold at the default edge of 1 mm. A coarser mesh follows curved faces by longer chords,
whose sagitta, and with it the errors of surface and volume, grows with the square of the edge:
``at_edge`` allows that much more and no more. Angles and the glued surface stay as they are.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.cad.mesh.mesh_quality import MeshQuality, Place
from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh

DEFAULT_EDGE_MM = 1.0
"""Edge of a mesh unless another is asked for, at which the gate's limits hold as they stand."""


@dataclass(frozen=True)
class QualityGate:
    """Limits of a mesh; what has not been measured is not judged."""

    min_dihedral_deg: float = 10.0
    max_bond_error_mm: float = 1e-6
    """Distance of a glued node from the surface it is glued to."""
    max_volume_error_percent: float = 0.5
    max_hausdorff_mm: float = 0.03
    max_interface_error_mm: float = 0.03
    """Distance of the faces between layers from where the pad's layers meet."""
    max_misplaced_percent: float = 0.5
    """Share of the volume in tets of another layer than their centre."""
    edge_mm: float = DEFAULT_EDGE_MM
    """Edge that the limits are meant for."""

    def at_edge(self, edge_mm: float) -> QualityGate:
        """The gate of meshes of this edge: errors of chords may grow with its square."""
        if not edge_mm > 0:
            raise InputError(f"edge_mm = {edge_mm!r} is not allowed; use a positive number")
        factor = max(1.0, (edge_mm / self.edge_mm) ** 2)
        return replace(
            self,
            max_volume_error_percent=self.max_volume_error_percent * factor,
            max_hausdorff_mm=self.max_hausdorff_mm * factor,
            max_interface_error_mm=self.max_interface_error_mm * factor,
            edge_mm=max(edge_mm, self.edge_mm),
        )


PRESS_GATE = QualityGate(
    min_dihedral_deg=2.0,
    max_volume_error_percent=5.0,
    max_hausdorff_mm=np.inf,
    max_interface_error_mm=0.1,
    max_misplaced_percent=2.0,
)
"""Meshes that are fine around one press and coarse elsewhere, which nothing there depends on."""


@dataclass(frozen=True)
class Violation:
    """One limit that a mesh breaks."""

    limit: str
    """Name of the limit."""
    found: float
    allowed: float
    unit: str
    count: int
    """Tets, nodes or regions that break it."""
    text: str
    """What is wrong, where, and what helps."""
    at_mm: Place | None = None
    """The worst place in the gel frame."""


@dataclass(frozen=True)
class GateResult:
    """What the gate found."""

    gate: QualityGate
    violations: tuple[Violation, ...]

    @property
    def passed(self) -> bool:
        return not self.violations

    def to_json(self) -> dict[str, Any]:
        """Plain values for JSON: the limits, the edge they are for, and what breaks them."""
        limits = {k: v if np.isfinite(v) else None for k, v in asdict(self.gate).items()}
        return {
            "passed": self.passed,
            "limits": limits,
            "relaxed_for_edge": self.gate.edge_mm > DEFAULT_EDGE_MM,
            "violations": [asdict(v) for v in self.violations],
        }


def check_quality(
    mesh: TetMesh, quality: MeshQuality, gate: QualityGate | None = None
) -> GateResult:
    """Every limit of ``gate`` that ``mesh`` breaks."""
    gate = gate or QualityGate()
    found = [
        *_volumes(mesh, quality),
        *_angles(mesh, quality, gate),
        *_limits(quality, gate),
        *_regions(quality),
    ]
    return GateResult(gate, tuple(found))


def bad_tets(mesh: TetMesh, gate: QualityGate) -> np.ndarray:
    """Tets that are inside out or have a dihedral angle below the gate's, bool, [tet_count]."""
    angles = dihedral_angles_deg(mesh.nodes_m, mesh.tets).min(axis=1)
    return (mesh.volumes_m3() <= 0) | (angles < gate.min_dihedral_deg)


def _at(place: Place | None) -> str:
    if place is None:
        return ""
    return f" at x {place[0]:.2f}, y {place[1]:.2f}, z {place[2]:.2f} mm"


def _volumes(mesh: TetMesh, quality: MeshQuality) -> list[Violation]:
    volumes = mesh.volumes_m3() * 1e9
    count = int((volumes <= 0).sum())
    if not count:
        return []
    x, y, z = mesh.nodes_m[mesh.tets[int(volumes.argmin())]].mean(axis=0) * 1e3
    place = float(x), float(y), float(z)
    text = (
        f"{count} of {mesh.tet_count} tets are flat or inside out, the worst of "
        f"{volumes.min():.3g} mm3{_at(place)}"
    )
    return [Violation("positive volumes", float(volumes.min()), 0.0, "mm3", count, text, place)]


def _angles(mesh: TetMesh, quality: MeshQuality, gate: QualityGate) -> list[Violation]:
    angles = dihedral_angles_deg(mesh.nodes_m, mesh.tets).min(axis=1)
    count = int((angles < gate.min_dihedral_deg).sum())
    if not count:
        return []
    place = quality.worst_tet_mm
    text = (
        f"{count} of {mesh.tet_count} tets have a dihedral angle under {gate.min_dihedral_deg:g} "
        f"deg, the worst of {angles.min():.3g} deg{_at(place)}"
    )
    return [
        Violation(
            "min_dihedral_deg", float(angles.min()), gate.min_dihedral_deg, "deg", count, text,
            place,
        )
    ]  # fmt: skip


def _limits(quality: MeshQuality, gate: QualityGate) -> list[Violation]:
    """Errors of surfaces, volume and layers above what the gate allows."""
    checks = (
        (
            "max_bond_error_mm", quality.back_plane_error_mm, "mm", quality.back_plane_worst_mm,
            "a glued node lies {found:.3g} mm off the glued surface{at}; allowed: {allowed:g} mm",
        ),
        (
            "max_volume_error_percent", quality.volume_error_percent, "%", None,
            "the mesh volume differs from the CAD volume by {found:.2f} %; allowed: "
            "{allowed:.3g} % (a smaller edge helps)",
        ),
        (
            "max_hausdorff_mm", quality.hausdorff_mm, "mm", quality.hausdorff_at_mm,
            "the mesh surface lies {found:.3g} mm off the CAD surface{at}; allowed: "
            "{allowed:.3g} mm (a smaller edge helps)",
        ),
        (
            "max_interface_error_mm", quality.interface_error_mm, "mm", None,
            "the faces between the layers lie up to {found:.3g} mm off where the layers meet; "
            "allowed: {allowed:.3g} mm",
        ),
        (
            "max_misplaced_percent", quality.misplaced_percent, "%", None,
            "{found:.2f} % of the volume is in tets of another layer than their centre; allowed: "
            "{allowed:g} %",
        ),
    )  # fmt: skip
    broken = []
    for limit, found, unit, place, words in checks:
        allowed = getattr(gate, limit)
        # What has not been measured is not judged.
        if found is not None and abs(found) > allowed:
            text = words.format(found=found, at=_at(place), allowed=allowed)
            broken.append(Violation(limit, found, allowed, unit, 1, text, place))
    return broken


def _regions(quality: MeshQuality) -> list[Violation]:
    missing = [
        region.name
        for region in (Region.CONTACT, Region.BOND, Region.WINDOW)
        if quality.region_areas_mm2[region.name.lower()] <= 0
    ]
    if not missing:
        return []
    text = f"the mesh has no {' and no '.join(missing)} faces"
    return [Violation("regions", 0.0, 0.0, "mm2", len(missing), text)]
