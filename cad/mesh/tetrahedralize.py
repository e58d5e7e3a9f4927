# SPDX-License-Identifier: Apache-2.0
"""Free-form tet meshes of any pad or imported part with fTetWild, up to the gate, cached.

fTetWild gives another mesh on every run, so a mesh is kept by the hash of its geometry and options.
A run that misses the gate is followed by finer ones, and by the same ones once more where one of
them missed it by flat tets alone, which is a run's luck; if none passes, the answer says what each
of them missed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.cad.mesh.closest import ClosestPoint, bond_projection
from taccel_lab.cad.mesh.gel_mesh import MESH_ARRAYS
from taccel_lab.cad.mesh.quality import (
    GateResult,
    MeshQuality,
    QualityGate,
    check_quality,
    measure_quality,
)
from taccel_lab.cad.mesh.surface import LabelledSurface, check_closed
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.mesh.tetwild import TetWildInput, run_tetwild
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.cad.parts.pad_solid import labelled_solid, layer_solids
from taccel_lab.cad.parts.part import LabelledSolid
from taccel_lab.errors import InputError
from taccel_lab.files.file_cache import CachedFile, load_arrays, save_arrays
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.guards import require_range

RECIPE = "tetwild-3"
"""Changes with the method, so that meshes of an older one are not taken for it."""
EDGE_BOUNDS_MM = (0.2, 20.0)
MAX_TETS = 1e6
"""Limit beyond which fTetWild takes hours: 20 million were not made in 10 min, and took 14 GB."""
EPSILON_BOUNDS = (1e-4, 1e-2)
_TRIES = ((1.0, 1.0), (1.0, 0.4), (0.75, 0.4))
"""Edge and epsilon of each run over those asked for."""
_ROUNDS = 2
"""Rounds: one in 20 of a small pad ends without a mesh."""
_FLAT = "min_dihedral_deg"
_ON_SURFACE_MM = 1e-3


@dataclass(frozen=True)
class _Try:
    edge_mm: float
    epsilon: float
    mesh: TetMesh | None
    result: GateResult | None
    text: str

    @property
    def unlucky(self) -> bool:
        """Whether flat tets are all that is wrong with its mesh."""
        return self.result is not None and {v.limit for v in self.result.violations} == {_FLAT}


def tetwild_gel_mesh(
    pad: Pad,
    edge_mm: float = 1.0,
    *,
    part: LabelledSolid | None = None,
    picture_folder: Path | str | None = None,
) -> TetMesh:
    """Mesh ``pad`` with tets of about ``edge_mm``; its surface keeps within half of the distance
    that the gate at this edge allows.

    ``part`` is the solid of the pad if it is already at hand. Regions come from the CAD faces,
    nodes of the glued surface lie exactly on it, and layers meet at faces of tets. Raises
    InputError when no run passes the gate, with the picture of the best one in ``picture_folder``
    if given.
    """
    part = part or labelled_solid(pad)
    # A finer input triples fTetWild's time and gains 0.04 % of volume.
    surface = tessellate_solid(part, tolerance_mm=0.01, angle_rad=0.1)
    given = TetWildInput(surface, _inner_triangles(pad, surface), pad.bond_projection_mm)
    exact: list[LabelledSurface] = []

    def measured(mesh: TetMesh) -> tuple[TetMesh, MeshQuality]:
        if not exact:
            exact.append(tessellate_solid(part))
        centers = mesh.nodes_m[mesh.tets].mean(axis=1) * 1e3
        mesh = replace(mesh, tet_layers=pad.layer_of(centers))
        cad = {"cad_volume_mm3": part.volume_mm3, "cad_surface": exact[0]}
        return mesh, measure_quality(mesh, pad, **cad)

    return _best(given, edge_mm, measured, picture_folder)


def tetwild_mesh(
    surface: LabelledSurface, edge_mm: float = 1.0, *, picture_folder: Path | str | None = None
) -> TetMesh:
    """Mesh an imported part from its closed labelled surface, in the gel frame.

    Glued nodes lie on the glued triangles, exactly on their planes where these are plane. Otherwise
    as ``tetwild_gel_mesh``, measured against ``surface`` itself.
    """
    check_closed(surface.triangles, "the surface to mesh")
    volume = surface.volume_mm3()
    if volume <= 0:
        raise InputError(
            f"the surface to mesh encloses {volume:.3g} mm3: its triangles wind inward; turn them "
            "outward (right-hand rule)"
        )
    missing = [r.name for r in Region if r != Region.SIDE and int(r) not in surface.regions]
    if missing:
        raise InputError(
            f"the surface to mesh has no {' and no '.join(missing)} triangles; label them first"
        )
    given = TetWildInput(surface, np.zeros((0, 3, 3)), bond_projection(surface))

    def measured(mesh: TetMesh) -> tuple[TetMesh, MeshQuality]:
        return mesh, measure_quality(mesh, None, cad_volume_mm3=volume, cad_surface=surface)

    return _best(given, edge_mm, measured, picture_folder)


def _best(
    given: TetWildInput,
    edge_mm: float,
    measured: Callable[[TetMesh], tuple[TetMesh, MeshQuality]],
    picture_folder: Path | str | None,
) -> TetMesh:
    """The first mesh that passes the gate; ``measured``: it with its layers, and its quality."""
    extents = np.ptp(given.surface.vertices_mm, axis=0)
    low, high = EDGE_BOUNDS_MM[0], min(EDGE_BOUNDS_MM[1], float(extents.max()) / 2)
    require_range("edge_mm", edge_mm, low, high)
    # Regular tets of this edge that fill the part.
    count = 6 * math.sqrt(2) * abs(given.surface.volume_mm3()) / edge_mm**3
    if count > MAX_TETS:
        least_mm = edge_mm * (count / MAX_TETS) ** (1 / 3)
        raise InputError(
            f"edge_mm = {edge_mm:g} would make about {count:.2g} tets of a part of "
            f"{' x '.join(f'{e:.4g}' for e in extents)} mm; at least {least_mm:.2g} mm is needed"
        )
    gate = QualityGate().at_edge(edge_mm)
    wanted = 0.5 * gate.max_hausdorff_mm / float(np.linalg.norm(extents))
    epsilon = float(np.clip(wanted, *EPSILON_BOUNDS))

    def build() -> TetMesh:
        return _build(given, edge_mm, epsilon, gate, measured, picture_folder)

    recipe = {
        "mesher": RECIPE,
        "vertices": given.surface.vertices_mm.round(6),
        "triangles": given.surface.triangles,
        "regions": given.surface.regions,
        "inner": given.inner_mm.round(6),
        "edge_mm": edge_mm,
        "epsilon": epsilon,
        "gate": [v if math.isfinite(v) else "any" for v in vars(gate).values()],
    }
    return cached_mesh(recipe).read_or_make(build)


def cached_mesh(recipe: Mapping[str, Any]) -> CachedFile[TetMesh]:
    """The file of the mesh that a recipe of plain values and arrays makes."""
    return CachedFile(
        "meshes",
        recipe,
        lambda file: TetMesh(**load_arrays(file)),
        lambda file, mesh: save_arrays(file, {name: getattr(mesh, name) for name in MESH_ARRAYS}),
    )


def _build(
    given: TetWildInput,
    edge_mm: float,
    epsilon: float,
    gate: QualityGate,
    measured: Callable[[TetMesh], tuple[TetMesh, MeshQuality]],
    picture_folder: Path | str | None,
) -> TetMesh:
    runs: list[tuple[float, float]] = []
    for edge_share, epsilon_share in _TRIES:
        edge = max(edge_mm * edge_share, EDGE_BOUNDS_MM[0])
        eps = max(epsilon * epsilon_share, EPSILON_BOUNDS[0])
        if (edge, eps) not in runs:
            runs.append((edge, eps))
    tried: list[_Try] = []
    for done in range(_ROUNDS):
        if done and not any(t.unlucky for t in tried):
            break
        for edge, eps in runs:
            try:
                mesh = run_tetwild(given, edge, eps, wanted_deg=gate.min_dihedral_deg)
            except InputError as error:
                tried.append(_Try(edge, eps, None, None, str(error)))
                continue
            mesh, quality = measured(mesh)
            result = check_quality(mesh, quality, gate)
            if result.passed:
                return mesh
            text = "; ".join(violation.text for violation in result.violations)
            tried.append(_Try(edge, eps, mesh, result, text))
    raise InputError(_failure(tried, picture_folder))


def _failure(tried: list[_Try], picture_folder: Path | str | None) -> str:
    runs = " | ".join(f"edge {t.edge_mm:g} mm, epsilon {t.epsilon:g}: {t.text}" for t in tried)
    text = f"fTetWild reached the mesh gate in none of {len(tried)} runs: {runs}"
    measured = [t for t in tried if t.mesh is not None and t.result is not None]
    if picture_folder is None or not measured:
        return text + ". A smaller edge_mm may help"
    best = min(measured, key=lambda t: len(t.result.violations) if t.result else 0)
    assert best.mesh is not None and best.result is not None  # ``measured`` holds no others
    return text + f". The picture {best.result.draw(best.mesh, picture_folder)} shows where"


def _inner_triangles(pad: Pad, surface: LabelledSurface) -> np.ndarray:
    """Triangles between the layers of ``pad`` as points [mm], shape [n, 3, 3]."""
    if len(pad.layer_names) < 2:
        return np.zeros((0, 3, 3))
    solid = layer_solids(pad)[pad.layer_names[0]]
    part = LabelledSolid(solid, [Region.SIDE] * len(solid.faces()))
    layer = tessellate_solid(part, tolerance_mm=0.01, angle_rad=0.1)
    corners = layer.vertices_mm[layer.triangles]
    distance, _ = ClosestPoint(surface.vertices_mm, surface.triangles)(corners.mean(axis=1))
    return corners[distance > _ON_SURFACE_MM]
