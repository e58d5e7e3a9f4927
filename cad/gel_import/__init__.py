# SPDX-License-Identifier: Apache-2.0
"""Gels from files of other programs, their faces selected by name, direction or number."""

from taccel_lab.cad.gel_import.gel_file import (
    SUFFIXES,
    WorkshopSolid,
    import_gel,
    part_faces,
    workshop_solid,
)
from taccel_lab.cad.gel_import.importer import (
    FaceSelection,
    ImportedGel,
    listing,
)
from taccel_lab.cad.gel_import.labelling import propose

__all__ = [
    "SUFFIXES",
    "FaceSelection",
    "ImportedGel",
    "WorkshopSolid",
    "import_gel",
    "listing",
    "part_faces",
    "propose",
    "workshop_solid",
]
