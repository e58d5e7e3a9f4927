# SPDX-License-Identifier: Apache-2.0
"""STEP files of other programs: their faces listed, a gel read, checked and labelled.

The CAD kernel crashes on some files, so it meets a file in the readers' process only, where
``gel_solid`` holds all that becomes of a gel. What comes back has passed every check.
"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.cad.step_import.importer import FaceSelection, ImportedGel
from taccel_lab.cad.step_import.selection import FaceInfo
from taccel_lab.errors import InputError, naming
from taccel_lab.files.apart import read_apart
from taccel_lab.files.regular_file import require_regular_file

MAX_BYTES = 50 << 20
"""Of a STEP file: a hundred times the largest of the sensors that we know, whose 271 faces take
0.5 MiB; the CAD kernel needs some 30 times the size of a file."""
LIMIT_S = 120.0
"""For all that the CAD kernel does with a file: 271 faces take it 8 s."""
_ORIGINS = ("center", "file")


def list_faces(path: Path | str, body: str = "") -> list[FaceInfo]:
    """Faces of the solid in a STEP file, numbered, in the file's own frame [mm].

    Raises InputError for a file without exactly one solid, or one of the name ``body``.
    """
    path = require_regular_file(Path(path), MAX_BYTES, "a STEP file")
    return read_apart(str(path), _faces, path, body, by="OCP", limit_s=LIMIT_S)


def import_gel(path: Path | str, selection: FaceSelection | None = None) -> ImportedGel:
    """Read, check and label a gel.

    Raises InputError for a file without exactly one closed, clean solid of a gel's size, and for
    selectors that choose nothing, overlap or leave a region empty; the message lists the faces.
    """
    selection = selection or FaceSelection()
    with naming(path):
        if selection.origin not in _ORIGINS:
            raise InputError(
                f"origin {selection.origin!r} is not allowed; use {' or '.join(_ORIGINS)}"
            )
        path = require_regular_file(Path(path), MAX_BYTES, "a STEP file")
        return read_apart(str(path), _gel, path, selection, by="OCP", limit_s=LIMIT_S)


# Called in the readers' process: only there does the kernel load for them.
def _faces(path: Path, body: str) -> list[FaceInfo]:
    from taccel_lab.cad.step_import.gel_solid import faces_of_step

    return faces_of_step(path, body)


def _gel(path: Path, selection: FaceSelection) -> ImportedGel:
    from taccel_lab.cad.step_import.gel_solid import gel_of_step

    return gel_of_step(path, selection)
