# SPDX-License-Identifier: Apache-2.0
"""Capture folders: the manifest, the loader, and the importer of the Taxim ball presses."""

from calibration.capture.captures import CaptureSet, ContactCircle, Press
from calibration.capture.load import load_captures
from calibration.capture.taxim_pack import find_taxim_pack, import_taxim

__all__ = [
    "CaptureSet",
    "ContactCircle",
    "Press",
    "find_taxim_pack",
    "import_taxim",
    "load_captures",
]
