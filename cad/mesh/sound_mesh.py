# SPDX-License-Identifier: Apache-2.0
"""The structured mesh of a pad where nobody asks for an edge length: finer until it is sound.

How well cells fit a fillet depends on how their count happens to divide it: a pad whose usual mesh
misses a limit by a hair often has a sound one at edges a fifth shorter.
"""

from __future__ import annotations

from taccel_lab.cad.mesh.gel_mesh import gel_mesh, usual_edge_mm
from taccel_lab.cad.mesh.quality import MeshQuality, QualityGate, check_quality, measure_quality
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.geometry import TetMesh

SHORTER = (1.0, 0.8, 0.6)
"""Edges that are tried, in units of the usual one."""


def sound_gel_mesh(
    pad: Pad, *, cad_volume_mm3: float | None = None, cad_surface: LabelledSurface | None = None
) -> tuple[TetMesh, MeshQuality, float]:
    """Mesh, quality and edge length [mm] of the first edge in ``SHORTER`` whose mesh passes the
    gate; those of the usual edge when none does, so that its faults can be listed.

    ``cad_volume_mm3`` and ``cad_surface`` as of ``measure_quality``.
    """
    usual = usual_edge_mm(pad)
    tried = []
    for share in SHORTER:
        edge_mm = share * usual
        mesh = gel_mesh(pad, edge_mm)
        quality = measure_quality(mesh, pad, cad_volume_mm3=cad_volume_mm3, cad_surface=cad_surface)
        tried.append((mesh, quality, edge_mm))
        if check_quality(mesh, quality, QualityGate().at_edge(edge_mm)).passed:
            return tried[-1]
    return tried[0]
