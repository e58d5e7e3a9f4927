# SPDX-License-Identifier: Apache-2.0
"""The structured mesh of a pad where nobody asks for an edge length: finer until it is sound, and
kept from one run to the next.

How well cells fit a fillet depends on how their count happens to divide it: a pad whose usual mesh
misses a limit by a hair often has a sound one at edges a fifth shorter.

A press meshes the gel around its contact, but heights and pictures also need the face as designed:
half a second for a mesh that is the same each time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, BinaryIO

import numpy as np

from taccel_lab import geometry
from taccel_lab.cad import mesh as meshers
from taccel_lab.cad import parameters, parts
from taccel_lab.cad.mesh.gel_mesh import gel_mesh, usual_edge_mm
from taccel_lab.cad.mesh.mesh_pad import SurfacePad
from taccel_lab.cad.mesh.quality import MeshQuality, QualityGate, check_quality, measure_quality
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.files.file_cache import (
    CachedFile,
    as_array,
    from_array,
    load_arrays,
    save_arrays,
    source_digest,
)
from taccel_lab.geometry import TetMesh

SHORTER = (1.0, 0.8, 0.6)
"""Edges that are tried, in units of the usual one."""
SoundMesh = tuple[TetMesh, MeshQuality, float]
"""Mesh, quality and edge length [mm], see ``sound_gel_mesh``."""
_ARRAYS = ("nodes_m", "tets", "faces", "face_regions", "tet_layers")
_ABOUT = "about"
_SOURCES = (parameters.__file__, *(p.__path__[0] for p in (meshers, parts, geometry)))
"""Files and folders of the code that makes the meshes."""


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
    return file.read_or_make(lambda: make(pad), optional=True)


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
    save_arrays(file, {_ABOUT: about, **{name: getattr(mesh, name) for name in _ARRAYS}})


def _load(file: BinaryIO) -> SoundMesh:
    arrays = load_arrays(file)
    about = from_array(arrays.pop(_ABOUT))
    figures: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in about["quality"].items()
    }
    return TetMesh(**arrays), MeshQuality(**figures), about["edge_mm"]
