# SPDX-License-Identifier: Apache-2.0
"""Capture folders: the manifest, the loader, and the importer of the Taxim ball presses."""

from calibration.capture.captures import CaptureSet, ContactCircle, Press
from calibration.capture.folder import (
    BoardCaptures,
    CaptureFolder,
    EdgeCapture,
    ForceRecord,
    Frame,
    MarkerCaptures,
    Video,
)
from calibration.capture.load import load_capture_folder, load_captures
from calibration.capture.taxim_pack import find_taxim_pack, import_taxim

__all__ = [
    "BoardCaptures",
    "CaptureFolder",
    "CaptureSet",
    "ContactCircle",
    "EdgeCapture",
    "ForceRecord",
    "Frame",
    "MarkerCaptures",
    "Press",
    "Video",
    "find_taxim_pack",
    "import_taxim",
    "load_capture_folder",
    "load_captures",
]
