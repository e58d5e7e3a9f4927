# SPDX-License-Identifier: Apache-2.0
"""Dots on the gel: found, numbered, fitted to a layout, followed through videos."""

from calibration.markers.detection import detect_dots
from calibration.markers.dots import DotFlag, Dots
from calibration.markers.finding import MarkerPicture, find_markers
from calibration.markers.lattice import Lattice, lattice_index
from calibration.markers.layout import LayoutFit, fit_layout
from calibration.markers.pitch import marker_pitch_px

__all__ = [
    "DotFlag",
    "Dots",
    "Lattice",
    "LayoutFit",
    "MarkerPicture",
    "detect_dots",
    "find_markers",
    "fit_layout",
    "lattice_index",
    "marker_pitch_px",
]
