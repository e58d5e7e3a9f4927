# SPDX-License-Identifier: Apache-2.0
"""Dots on the gel: found, numbered, fitted to a layout, followed through videos."""

from calibration.markers.calibrate import calibrate_markers
from calibration.markers.choose_view import choose_view
from calibration.markers.detection import detect_dots
from calibration.markers.dots import DotFlag, Dots
from calibration.markers.finding import MarkerPicture, find_markers
from calibration.markers.flow import MarkerFlow, marker_flow_mm
from calibration.markers.gel_view import CameraView, GelView, GridView, camera_view, grid_view
from calibration.markers.lattice import Lattice, lattice_index
from calibration.markers.layout import LayoutFit, fit_layout
from calibration.markers.pitch import marker_pitch_px
from calibration.markers.result import MarkerCalibration, TrackedVideo
from calibration.markers.track_figures import TrackFigures, track_figures
from calibration.markers.tracking import track_markers
from calibration.markers.tracks import MarkerTracks, Status

__all__ = [
    "CameraView",
    "DotFlag",
    "Dots",
    "GelView",
    "GridView",
    "Lattice",
    "LayoutFit",
    "MarkerCalibration",
    "MarkerFlow",
    "MarkerPicture",
    "MarkerTracks",
    "Status",
    "TrackFigures",
    "TrackedVideo",
    "calibrate_markers",
    "camera_view",
    "choose_view",
    "detect_dots",
    "find_markers",
    "fit_layout",
    "grid_view",
    "lattice_index",
    "marker_flow_mm",
    "marker_pitch_px",
    "track_figures",
    "track_markers",
]
