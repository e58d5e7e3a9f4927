# SPDX-License-Identifier: Apache-2.0
"""Gels from STEP files of other programs, their faces selected by name, direction or number."""

from taccel_lab.cad.step_import.importer import FaceSelection, ImportedGel
from taccel_lab.cad.step_import.selection import FaceInfo, listing
from taccel_lab.cad.step_import.step_file import import_gel, list_faces

__all__ = ["FaceInfo", "FaceSelection", "ImportedGel", "import_gel", "list_faces", "listing"]
