# SPDX-License-Identifier: Apache-2.0
"""Calibration of the camera: boards, lens, pose of the gel, scale, rectification."""

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.detect import Detections, detect_board, detect_views
from taccel_lab.calibration.camera.fit import CameraCalibration, calibrate_camera
from taccel_lab.calibration.camera.intrinsics import Intrinsics, calibrate_intrinsics
from taccel_lab.calibration.camera.on_gel import OnGel, fit_on_gel
from taccel_lab.calibration.camera.rectification import RectificationMaps, gel_maps, lens_maps
from taccel_lab.calibration.camera.report import camera_page

__all__ = [
    "BoardView",
    "CameraCalibration",
    "Detections",
    "Intrinsics",
    "OnGel",
    "RectificationMaps",
    "calibrate_camera",
    "calibrate_intrinsics",
    "camera_page",
    "detect_board",
    "detect_views",
    "fit_on_gel",
    "gel_maps",
    "lens_maps",
]
