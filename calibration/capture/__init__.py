# SPDX-License-Identifier: Apache-2.0
"""Capture folders: the manifest, the loader, and importers of other projects' layouts."""

from taccel_lab.calibration.capture.captures import CapturedPress, CaptureSet, ContactCircle, Frame
from taccel_lab.calibration.capture.folder import (
    BoardCaptures,
    CaptureFolder,
    EdgeCapture,
    ForceRecord,
    MarkerCaptures,
    Video,
)
from taccel_lab.calibration.capture.importers import ImportOptions, import_captures
from taccel_lab.calibration.capture.load import load_capture_folder, load_captures
from taccel_lab.calibration.capture.taxim_pack import find_taxim_pack

__all__ = [
    "BoardCaptures",
    "CaptureFolder",
    "CaptureSet",
    "CapturedPress",
    "ContactCircle",
    "EdgeCapture",
    "ForceRecord",
    "Frame",
    "ImportOptions",
    "MarkerCaptures",
    "Video",
    "find_taxim_pack",
    "import_captures",
    "load_capture_folder",
    "load_captures",
]
