# SPDX-License-Identifier: Apache-2.0
"""One door to the quality of a mesh: its figures, the gate, and the refusal with a picture."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.cad.mesh.mesh_quality import MeshQuality, measure_quality, surface_distance_mm
from taccel_lab.cad.mesh.quality_gate import (
    PRESS_GATE,
    GateResult,
    QualityGate,
    Violation,
    check_quality,
)
from taccel_lab.cad.mesh.quality_picture import write_bad_mesh
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh

__all__ = [
    "PRESS_GATE",
    "GateResult",
    "MeshQuality",
    "QualityGate",
    "Violation",
    "check_quality",
    "measure_quality",
    "require_quality",
    "surface_distance_mm",
]


def require_quality(
    mesh: TetMesh,
    quality: MeshQuality,
    gate: QualityGate | None = None,
    *,
    picture_folder: Path | str | None = None,
) -> GateResult:
    """Raise InputError with every broken limit, its figure and place, or return the passed result.

    With ``picture_folder`` a picture of the bad places, bad_mesh.png, is written there first.
    """
    result = check_quality(mesh, quality, gate)
    if result.passed:
        return result
    text = "the mesh is unfit to be simulated: " + "; ".join(v.text for v in result.violations)
    if picture_folder is not None:
        path = write_bad_mesh(mesh, result, picture_folder)
        text += f". The picture {path} shows where"
    raise InputError(text)
