# SPDX-License-Identifier: Apache-2.0
"""How good a gel mesh is and how true to its pad, in figures, and the gate that it passes before
anything is simulated on it: every limit that it breaks is named, by how much and where.

A mesh with flat tets solves without complaint and answers nonsense, and one whose surface is off
answers for another pad.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.cad.mesh.closest import ClosestPoint, surface_distance
from taccel_lab.cad.mesh.quality_measures import (
    TET_FACES,
    dihedral_angles_deg,
    layer_errors,
    mean_ratios,
)
from taccel_lab.cad.mesh.surface import LabelledSurface, check_closed
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_by
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.tet_mesh import tet_volumes

DEFAULT_EDGE_MM = 1.0
"""Edge of a mesh unless another is requested, at which the gate's limits hold as they stand."""

Place = tuple[float, ...]
"""x, y and z in the gel frame."""
_BAD, _PLACE = "#d4301f", "#1f5fd4"
_LEAST_ZOOM_MM = 1.0
_MOST_TEXT = 150


@dataclass(frozen=True)
class MeshQuality:
    """Figures of one mesh; lengths in millimetres, angles in degrees."""

    node_count: int
    tet_count: int
    min_dihedral_deg: float
    p1_dihedral_deg: float
    """First percentile over tets of their smallest dihedral angle."""
    max_dihedral_deg: float
    min_mean_ratio: float
    mean_mean_ratio: float
    worst_tet_mm: Place
    """Centre of the tet with the smallest dihedral angle."""
    min_edge_mm: float
    max_edge_mm: float
    """Longest edge of the boundary."""
    volume_mm3: float
    min_volume_mm3: float
    """Smallest signed volume of a tet."""
    back_plane_error_mm: float
    """Greatest distance of a glued node from the surface it is glued to."""
    back_plane_worst_mm: Place | None
    contact_error_mm: float
    """Greatest distance of a contact node from the formula of the contact face."""
    region_areas_mm2: dict[str, float]
    layer_volumes_mm3: tuple[float, ...]
    """Volume of each material layer."""
    volume_error_percent: float | None = None
    """Volume against the CAD solid, negative when the mesh is smaller."""
    hausdorff_mm: float | None = None
    """Greatest distance between mesh and CAD surface, sampled both ways."""
    surface_rms_mm: float | None = None
    """Root mean square distance of the mesh surface from the CAD surface."""
    hausdorff_at_mm: Place | None = None
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
    angles, ratios = dihedral_angles_deg(nodes, mesh.tets), mean_ratios(nodes, mesh.tets)
    smallest = angles.min(axis=1)
    edges = np.linalg.norm(nodes[mesh.faces] - nodes[np.roll(mesh.faces, 1, axis=1)], axis=-1)
    volumes = tet_volumes(nodes, mesh.tets)
    areas = LabelledSurface(nodes, mesh.faces, mesh.face_regions).areas_mm2()
    glued, touched = nodes[mesh.bonded_nodes()], nodes[mesh.region_nodes(Region.CONTACT)]
    off_glue, off_contact = np.zeros(len(glued)), np.zeros(len(touched))
    if pad is not None:
        off_glue = np.linalg.norm(glued - pad.bond_projection_mm(glued), axis=1)
        off_contact = pad.contact_error_mm(touched)
    elif cad_surface is not None:
        off_glue = _from_regions(glued, cad_surface, Region.BOND, Region.WINDOW)
        off_contact = _from_regions(touched, cad_surface, Region.CONTACT)
    quality = MeshQuality(
        node_count=mesh.node_count,
        tet_count=mesh.tet_count,
        min_dihedral_deg=float(smallest.min()),
        p1_dihedral_deg=float(np.percentile(smallest, 1)),
        max_dihedral_deg=float(angles.max()),
        min_mean_ratio=float(ratios.min()),
        mean_mean_ratio=float(ratios.mean()),
        worst_tet_mm=tuple(nodes[mesh.tets[int(smallest.argmin())]].mean(axis=0).tolist()),
        min_edge_mm=float(edges.min()),
        max_edge_mm=float(edges.max()),
        volume_mm3=float(volumes.sum()),
        min_volume_mm3=float(volumes.min()),
        back_plane_error_mm=float(off_glue.max(initial=0)),
        back_plane_worst_mm=tuple(glued[int(off_glue.argmax())].tolist()) if len(glued) else None,
        contact_error_mm=float(off_contact.max(initial=0)),
        region_areas_mm2={
            r.name.lower(): float(areas[mesh.face_regions == int(r)].sum()) for r in Region
        },
        layer_volumes_mm3=tuple(np.bincount(mesh.tet_layers, volumes).tolist()),
    )
    more: dict[str, Any] = {}
    if cad_volume_mm3 is not None:
        more["volume_error_percent"] = 100 * (quality.volume_mm3 / cad_volume_mm3 - 1)
    if cad_surface is not None:
        more["hausdorff_mm"], at, more["surface_rms_mm"] = surface_distance(
            (nodes, mesh.faces), (cad_surface.vertices_mm, cad_surface.triangles)
        )
        more["hausdorff_at_mm"] = tuple(at.tolist())
    if pad is not None and len(pad.layer_names) > 1:
        more |= layer_errors(mesh, pad)
    return replace(quality, **more)


def _from_regions(points_mm: np.ndarray, cad: LabelledSurface, *regions: Region) -> np.ndarray:
    """Distance of points from the triangles of regions [mm]; 0 where there are none."""
    triangles = cad.triangles[np.isin(cad.regions, regions)]
    if not (len(triangles) and len(points_mm)):
        return np.zeros(len(points_mm))
    return ClosestPoint(cad.vertices_mm, triangles)(points_mm)[0]


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
        """The gate of meshes of this edge: the sagitta of chords, and with it the errors of surface
        and volume, may grow with its square. Angles and the glued surface stay as they are."""
        if not edge_mm > 0:
            raise InputError(f"edge_mm = {edge_mm!r} is not allowed; use a positive number")
        factor = max(1.0, (edge_mm / self.edge_mm) ** 2)
        chords = ("max_volume_error_percent", "max_hausdorff_mm", "max_interface_error_mm")
        grown = {name: getattr(self, name) * factor for name in chords}
        return replace(self, **grown, edge_mm=max(edge_mm, self.edge_mm))


PRESS_GATE = QualityGate(2.0, 1e-6, 5.0, np.inf, 0.1, 2.0)
"""Meshes that are fine around one press and coarse elsewhere, which nothing there depends on."""


_LIMITS = (
    ("max_bond_error_mm", "back_plane_error_mm", "back_plane_worst_mm", "mm",
     "a glued node lies {found:.3g} mm off the glued surface{at}; allowed: {allowed:g} mm"),
    ("max_volume_error_percent", "volume_error_percent", None, "%",
     "the mesh volume differs from the CAD volume by {found:.2f} %; allowed: {allowed:.3g} % "
     "(a smaller edge helps)"),
    ("max_hausdorff_mm", "hausdorff_mm", "hausdorff_at_mm", "mm",
     "the mesh surface lies {found:.3g} mm off the CAD surface{at}; allowed: {allowed:.3g} mm "
     "(a smaller edge helps)"),
    ("max_interface_error_mm", "interface_error_mm", None, "mm",
     "the faces between the layers lie up to {found:.3g} mm off where the layers meet; allowed: "
     "{allowed:.3g} mm"),
    ("max_misplaced_percent", "misplaced_percent", None, "%",
     "{found:.2f} % of the volume is in tets of another layer than their centre; allowed: "
     "{allowed:g} %"),
)  # fmt: skip
"""Limit of the gate, figure that it bounds, its worst place, unit, and what is said of it."""


@dataclass(frozen=True)
class Violation:
    """One limit that a mesh breaks."""

    limit: str
    found: float
    allowed: float
    unit: str
    count: int
    """Tets, nodes or regions that break it."""
    text: str
    """What is wrong, where, and what helps."""
    at_mm: Place | None = None


@dataclass(frozen=True)
class GateResult:
    """What the gate found."""

    gate: QualityGate
    violations: tuple[Violation, ...]
    bad: np.ndarray
    """Tets that are inside out or have a dihedral angle below the gate's, bool, [tet_count]."""

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

    def draw(self, mesh: TetMesh, folder: Path | str) -> Path:
        """A picture of the bad places of ``mesh``, bad_mesh.png in ``folder``."""
        places = [v.at_mm for v in self.violations if v.at_mm is not None]
        return write_bad_mesh(mesh, self.bad, places, [v.text for v in self.violations], folder)


def require_quality(
    mesh: TetMesh,
    quality: MeshQuality,
    gate: QualityGate | None = None,
    *,
    picture_folder: Path | str | None = None,
) -> GateResult:
    """Raise InputError with every broken limit, its figure and place, or return the passed result.
    With ``picture_folder`` a picture of the bad places, bad_mesh.png, is written there first."""
    result = check_quality(mesh, quality, gate)
    if result.passed:
        return result
    text = "the mesh is unfit to be simulated: " + "; ".join(v.text for v in result.violations)
    if picture_folder is not None:
        text += f". The picture {result.draw(mesh, picture_folder)} shows where"
    raise InputError(text)


def check_quality(
    mesh: TetMesh, quality: MeshQuality, gate: QualityGate | None = None
) -> GateResult:
    """Every limit of ``gate`` that ``mesh`` breaks."""
    gate = gate or QualityGate()
    nodes, least = mesh.nodes_m * 1e3, gate.min_dihedral_deg
    volumes, angles = (
        tet_volumes(nodes, mesh.tets),
        dihedral_angles_deg(nodes, mesh.tets).min(axis=1),
    )
    inverted, thin, broken = volumes <= 0, angles < least, []
    words = f"have a dihedral angle under {least:g} deg"
    for limit, values, bad, allowed, unit, what in (
        ("positive volumes", volumes, inverted, 0.0, "mm3", "are flat or inside out"),
        ("min_dihedral_deg", angles, thin, least, "deg", words),
    ):
        if count := int(bad.sum()):
            worst = float(values.min())
            place = tuple(nodes[mesh.tets[int(values.argmin())]].mean(axis=0).tolist())
            text = f"{count} of {mesh.tet_count} tets {what}, the worst of {worst:.3g} {unit}"
            broken.append(Violation(limit, worst, allowed, unit, count, text + _at(place), place))
    for limit, figure, where, unit, words in _LIMITS:
        found, allowed = getattr(quality, figure), getattr(gate, limit)
        place = getattr(quality, where) if where else None
        # What has not been measured is not judged.
        if found is not None and abs(found) > allowed:
            text = words.format(found=found, at=_at(place), allowed=allowed)
            broken.append(Violation(limit, found, allowed, unit, 1, text, place))
    needed = (Region.CONTACT, Region.BOND, Region.WINDOW)
    if missing := [r.name for r in needed if quality.region_areas_mm2[r.name.lower()] <= 0]:
        text = f"the mesh has no {' and no '.join(missing)} faces"
        broken.append(Violation("regions", 0.0, 0.0, "mm2", len(missing), text))
    return GateResult(gate, tuple(broken), inverted | thin)


def _at(place: Place | None) -> str:
    return "" if place is None else " at x {:.2f}, y {:.2f}, z {:.2f} mm".format(*place)


def write_bad_mesh(
    mesh: TetMesh,
    bad: np.ndarray,
    places_mm: Sequence[Sequence[float]],
    texts: Sequence[str],
    folder: Path | str,
) -> Path:
    """Draw the surface of ``mesh`` in light grey, ``bad`` tets (bool, [tet_count]) in red, other
    bad places as crosses, and say the texts above: bad_mesh.png in ``folder``.
    On the left the whole mesh, on the right the worst place from close by."""
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    nodes = mesh.nodes_m * 1e3
    centers, corners = nodes[mesh.tets].mean(axis=1), nodes[mesh.tets][:, TET_FACES]
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    places = np.reshape(places_mm, (-1, 3))
    middle = np.concatenate([places, centers[bad], nodes.mean(axis=0, keepdims=True)])[0]
    nearest = int(np.linalg.norm(centers - middle, axis=1).argmin())
    reach = max(2.2 * float(np.ptp(nodes[mesh.tets[nearest]], axis=0).max()), _LEAST_ZOOM_MM)
    # Seen from the side on which the first bad place lies.
    arm = (places[0] if len(places) else high) - 0.5 * (low + high)
    azimuth = np.rad2deg(np.arctan2(arm[1], arm[0])) if np.hypot(*arm[:2]) > 1e-6 else -60.0
    view = {"elev": -24 if arm[2] < -0.25 * (high - low)[2] else 28, "azim": azimuth + 25}
    figure = Figure(figsize=(13, 6.4), dpi=110)
    around = {f"worst place, {2 * reach:.2g} mm wide": (middle - reach, middle + reach)}
    boxes = {"whole mesh": (low, high)} | around
    for column, (title, (low, high)) in enumerate(boxes.items(), 1):
        axes: Any = figure.add_subplot(1, 2, column, projection="3d", computed_zorder=False)
        for name, least, most in zip("xyz", low, high, strict=True):
            axes.set(**{f"{name}lim": (least, most), f"{name}label": f"{name} [mm]"})
            axes.locator_params(name, nbins=4)
        axes.set_title(title, fontsize=10)
        axes.set_box_aspect(high - low)
        axes.tick_params(labelsize=8)
        axes.view_init(**view)
        faces, places_in, tets = (
            ((at >= low) & (at <= high)).all(axis=1)
            for at in (nodes[mesh.faces].mean(axis=1), places, centers)
        )
        for triangles, color, edges, width in (
            (nodes[mesh.faces[faces]], (0.8, 0.8, 0.8, 0.2), (0.45, 0.45, 0.45, 0.5), 0.3),
            (corners[bad & tets].reshape(-1, 3, 3), _BAD, "#7a1108", 0.7),
        ):
            style = {"facecolors": color, "edgecolors": edges, "linewidths": width}
            axes.add_collection3d(Poly3DCollection(triangles, **style))
        crosses = places[places_in].T
        axes.scatter(*crosses, marker="x", s=70, color=_PLACE, depthshade=False, zorder=10)
    legend = f"red: {int(bad.sum())} bad tets; blue crosses: the worst place of each limit"
    figure.text(0.5, 0.03, legend, ha="center")
    lines = [textwrap.shorten(text, _MOST_TEXT, placeholder="...") for text in texts]
    figure.suptitle("\n".join(lines), fontsize=9, y=0.99, va="top")
    figure.subplots_adjust(0.01, 0.09, 0.95, 0.97 - 0.025 * len(lines), wspace=0.08)
    path = Path(folder) / "bad_mesh.png"
    write_by(path, lambda file: figure.savefig(file, format="png"))
    return path
