# SPDX-License-Identifier: Apache-2.0
"""One entry to the structured mesher: the mesh of any pad, even or fine around a contact.

Structured meshes keep their connectivity over every change of a pad's dimensions, and their size is
known beforehand, so that a sweep over designs is one batch of environments.
"""

from __future__ import annotations

from dataclasses import replace

from taccel_lab.cad.mesh.dome_mesh import even_dome_mesh, focused_dome_mesh
from taccel_lab.cad.mesh.focus import FocusOptions
from taccel_lab.cad.mesh.mesh_pad import MeshPad
from taccel_lab.cad.mesh.pad_mesh import even_pad_mesh, focused_pad_mesh
from taccel_lab.cad.mesh.quality import DEFAULT_EDGE_MM
from taccel_lab.cad.parts.dome_pad import DomePad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh

DOME_RINGS = 4
"""Rings that a dome needs beyond those of a pad: from the apex to its edge it is twice as far."""


def usual_edge_mm(pad: Pad) -> float:
    """Edge length of a mesh where nobody asks for another [mm]: 1 mm, or the thickness of a thinner
    gel."""
    return min(DEFAULT_EDGE_MM, pad.thickness_mm)


def gel_mesh(pad: Pad, edge_mm: float | None = None, *, counts_of: Pad | None = None) -> TetMesh:
    """Structured mesh of ``pad`` whose elements are about ``edge_mm`` long, ``usual_edge_mm`` when
    None.

    ``counts_of`` names the pad whose dimensions choose how many cells there are: with the same one
    every pad of a sweep has the same connectivity. So far for pads with a flat back. A pad that is
    a mesh has that one.

    Raises InputError for an edge out of bounds, or when cells fold over.
    """
    if isinstance(pad, MeshPad):
        return pad.mesh
    edge_mm = usual_edge_mm(pad) if edge_mm is None else edge_mm
    if isinstance(pad, HeightPad) and (counts_of is None or isinstance(counts_of, HeightPad)):
        return even_pad_mesh(pad, edge_mm, counts_of)
    if counts_of is not None:
        raise InputError(
            f"counts_of: {type(pad).__name__} cannot have the cell counts of "
            f"{type(counts_of).__name__}; both must be pads with a flat back"
        )
    if isinstance(pad, DomePad):
        return even_dome_mesh(pad, edge_mm)
    raise InputError(f"no structured mesher for {type(pad).__name__}; use the mesher tetwild")


def focused_gel_mesh(pad: Pad, focus: FocusOptions) -> TetMesh:
    """Structured mesh of ``pad``, fine around a contact, of the same connectivity anywhere.

    Raises InputError for a focus too near to the edge of the contact face, FoldedMeshError when
    cells fold over.
    """
    if isinstance(pad, HeightPad):
        return focused_pad_mesh(pad, focus)
    if isinstance(pad, DomePad):
        return focused_dome_mesh(pad, replace(focus, rings=focus.rings + DOME_RINGS))
    raise InputError(f"no focused mesher for {type(pad).__name__}")
