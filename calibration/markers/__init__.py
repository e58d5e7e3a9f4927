# SPDX-License-Identifier: Apache-2.0
"""Dots on the gel: found, numbered, fitted to a layout, followed through videos."""

from taccel_lab.calibration.markers.choose_view import choose_view
from taccel_lab.calibration.markers.detection import detect_dots
from taccel_lab.calibration.markers.dots import DotFlag, Dots
from taccel_lab.calibration.markers.finding import MarkerPicture, find_markers
from taccel_lab.calibration.markers.fit import calibrate_markers
from taccel_lab.calibration.markers.flow import MarkerFlow, marker_flow_mm
from taccel_lab.calibration.markers.gel_view import (
    CameraView,
    GelView,
    GridView,
    camera_view,
    grid_view,
)
from taccel_lab.calibration.markers.lattice import Lattice, lattice_index
from taccel_lab.calibration.markers.layout import LayoutFit, fit_layout
from taccel_lab.calibration.markers.pitch import marker_pitch_px
from taccel_lab.calibration.markers.result import MarkerCalibration, TrackedVideo
from taccel_lab.calibration.markers.track_figures import TrackFigures, track_figures
from taccel_lab.calibration.markers.tracking import track_markers
from taccel_lab.calibration.markers.tracks import MarkerTracks, Status

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
