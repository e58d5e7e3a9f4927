# SPDX-License-Identifier: Apache-2.0
"""One entry to the structured mesher: the mesh of any pad, even or fine around a contact.

Structured meshes keep their connectivity over every change of a pad's dimensions, and their size is
known beforehand, so that a sweep over designs is one batch of environments.

Where nobody asks for an edge length, meshes become finer until they are sound: how well cells fit a
fillet depends on how their count happens to divide it, and a pad whose usual mesh misses a limit by
a hair often has a sound one at edges a fifth shorter. They are kept from one run to the next. A
press meshes the gel around its contact, but heights and pictures also need the face as designed:
half a second for a mesh that is the same each time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np

from taccel_lab import geometry
from taccel_lab.cad import mesh as meshers
from taccel_lab.cad import parameters, parts
from taccel_lab.cad.mesh.dome_mesh import Dome, even_dome_mesh, focused_dome_mesh
from taccel_lab.cad.mesh.focus import FocusOptions
from taccel_lab.cad.mesh.mesh_pad import MeshPad, SurfacePad
from taccel_lab.cad.mesh.pad_mesh import even_pad_mesh, focused_pad_mesh
from taccel_lab.cad.mesh.quality import (
    DEFAULT_EDGE_MM,
    MeshQuality,
    QualityGate,
    check_quality,
    measure_quality,
)
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.files.file_cache import (
    CachedFile,
    as_array,
    from_array,
    load_arrays,
    save_arrays,
    source_digest,
)
from taccel_lab.geometry import TetMesh

DOME_RINGS = 4
"""Rings that a dome needs beyond those of a pad: from the apex to its edge it is twice as far."""
SHORTER = (1.0, 0.8, 0.6)
"""Edges that are tried, in units of the usual one."""
SoundMesh = tuple[TetMesh, MeshQuality, float]
"""Mesh, quality and edge length [mm], see ``sound_gel_mesh``."""
MESH_ARRAYS = ("nodes_m", "tets", "faces", "face_regions", "tet_layers")
_ABOUT = "about"
_SOURCES = (parameters.__file__, *(p.__path__[0] for p in (meshers, parts, geometry)))
"""Files and folders of the code that makes the meshes."""


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
    if isinstance(pad, Dome):
        return even_dome_mesh(pad, edge_mm)
    raise InputError(f"no structured mesher for {type(pad).__name__}; use the mesher tetwild")


def focused_gel_mesh(pad: Pad, focus: FocusOptions) -> TetMesh:
    """Structured mesh of ``pad``, fine around a contact, of the same connectivity anywhere.

    Raises InputError for a focus too near to the edge of the contact face, FoldedMeshError when
    cells fold over.
    """
    if isinstance(pad, HeightPad):
        return focused_pad_mesh(pad, focus)
    if isinstance(pad, Dome):
        return focused_dome_mesh(pad, replace(focus, rings=focus.rings + DOME_RINGS))
    raise InputError(f"no focused mesher for {type(pad).__name__}")


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


def kept_mesh(pad: Pad, make: Callable[[Pad], SoundMesh]) -> SoundMesh:
    """The mesh of ``pad`` from the cache folder, or ``make(pad)``, which is then kept where that
    folder can be written. A pad that is no formula of this package's is made each time."""
    if not is_formula(pad):
        return make(pad)
    file = CachedFile("meshes", _recipe(pad), _load, _save)
    return file.read_or_make(lambda: make(pad))


def is_formula(pad: Pad) -> bool:
    """Whether a pad is one of this package, which its values say all of."""
    return type(pad).__module__.startswith("taccel_lab.cad.") and not isinstance(pad, SurfacePad)


def _recipe(pad: Pad) -> dict[str, Any]:
    import scipy

    return {
        "mesher": source_digest(*_SOURCES),
        "libraries": [np.__version__, scipy.__version__],
        "pad": f"{type(pad).__module__}.{type(pad).__qualname__}",
        "values": pad.values(),
    }


def _save(file: BinaryIO, result: SoundMesh) -> None:
    mesh, quality, edge_mm = result
    about = as_array({"quality": quality.to_json(), "edge_mm": edge_mm})
    save_arrays(file, {_ABOUT: about, **{name: getattr(mesh, name) for name in MESH_ARRAYS}})


def _load(file: BinaryIO) -> SoundMesh:
    arrays = load_arrays(file)
    about = from_array(arrays.pop(_ABOUT))
    figures: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in about["quality"].items()
    }
    return TetMesh(**arrays), MeshQuality(**figures), about["edge_mm"]
