# SPDX-License-Identifier: Apache-2.0
"""Files of other programs that hold a gel: their faces shown, a gel read, checked and labelled.

The CAD kernel crashes on some STEP files, so it meets one in the readers' process only, where
``step_gel`` holds all that becomes of it. Triangles and tets are read there, too. What comes back
has passed every check.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.cad.gel_import.faces import PartFaces
from taccel_lab.cad.gel_import.importer import FaceSelection, ImportedGel
from taccel_lab.cad.gel_import.step_parts import require_step_file
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.errors import InputError, naming
from taccel_lab.files import tet_file, triangle_file
from taccel_lab.files.apart import read_apart
from taccel_lab.files.regular_file import require_regular_file

if TYPE_CHECKING:
    from taccel_lab.cad.parts.labelled_solid import LabelledSolid

STEP = (".step", ".stp")
SUFFIXES = (*STEP, *triangle_file.SUFFIXES, *tet_file.SUFFIXES)
"""Endings of files that a gel is read from."""
LIMIT_S = 120.0
"""Time limit of the CAD kernel with a file: 271 faces take it 8 s."""
MAX_FACETS = 1_000
"""Triangles of a gel that get a solid."""
_ORIGINS = ("center", "file")


def part_faces(path: Path | str, body: str = "", unit: str = "") -> PartFaces:
    """Faces of the body in a file, numbered, in the file's own frame, triangles and tets in
    millimetres.

    Raises InputError for a file without exactly one body, or one of the name or number ``body``.
    """
    path = Path(path)
    kind = _kind(path)
    if kind == "triangles":
        from taccel_lab.cad.gel_import.triangle_gel import faces_of_triangle_file

        return faces_of_triangle_file(path, body, unit)
    if kind == "tets":
        from taccel_lab.cad.gel_import.triangle_gel import faces_of_tet_file

        return faces_of_tet_file(path, body, unit)
    path = require_step_file(path)
    with naming(path):
        return read_apart(str(path), _faces_of_step, path, body, by="OCP", limit_s=LIMIT_S)


def import_gel(path: Path | str, selection: FaceSelection | None = None) -> ImportedGel:
    """Read, check and label a gel.

    Raises InputError for a file without exactly one closed, clean body of a gel's size, and for
    selectors that choose nothing, overlap or leave a region empty; the message lists the faces.
    """
    path, selection = Path(path), selection or FaceSelection()
    with naming(path):
        if selection.origin not in _ORIGINS:
            raise InputError(
                f"origin {selection.origin!r} is not allowed; use {' or '.join(_ORIGINS)}"
            )
        kind = _kind(path)
        if kind == "triangles":
            from taccel_lab.cad.gel_import.triangle_gel import gel_of_triangle_file

            return gel_of_triangle_file(path, selection)
        if kind == "tets":
            from taccel_lab.cad.gel_import.triangle_gel import gel_of_tet_file

            return gel_of_tet_file(path, selection)
        path = require_step_file(path)
        return read_apart(str(path), _gel_of_step, path, selection, by="OCP", limit_s=LIMIT_S)


def workshop_solid(gel: ImportedGel) -> LabelledSolid | None:
    """The solid that moulds and drawings are made of: the file's own, or one of plane faces for
    triangles; None of more than ``MAX_FACETS``, which the CAD kernel takes minutes for.

    Raises InputError where the kernel makes no solid of the triangles.
    """
    if gel.part is not None or len(gel.surface.triangles) > MAX_FACETS:
        return gel.part
    return read_apart(gel.name, _facet_solid, gel.surface, by="OCP", limit_s=LIMIT_S)


def _kind(path: Path) -> str:
    require_regular_file(path, triangle_file.MAX_BYTES, "a gel's file")
    # A link may be named by its digest, and so may the file that it leads to.
    names = (path, Path(os.path.realpath(path)))
    suffix = next((n.suffix.lower() for n in names if n.suffix.lower() in SUFFIXES), path.suffix)
    if suffix in triangle_file.SUFFIXES:
        return "triangles"
    if suffix in tet_file.SUFFIXES:
        return "tets"
    if suffix in STEP:
        return "step"
    raise InputError(f"{path}: a gel is read from {', '.join(SUFFIXES)}; not from {suffix!r}")


# Called in the readers' process: only there does the kernel load for them.
def _faces_of_step(path: Path, body: str) -> PartFaces:
    from taccel_lab.cad.gel_import.step_gel import faces_of_step

    return faces_of_step(path, body)


def _gel_of_step(path: Path, selection: FaceSelection) -> ImportedGel:
    from taccel_lab.cad.gel_import.step_gel import gel_of_step

    return gel_of_step(path, selection)


def _facet_solid(surface: LabelledSurface) -> LabelledSolid:
    from taccel_lab.cad.gel_import.facet_solid import facet_solid

    return facet_solid(surface)
