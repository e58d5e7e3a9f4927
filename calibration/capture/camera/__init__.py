# SPDX-License-Identifier: Apache-2.0
"""Cameras: of a sensor that is plugged in, or replayed from images and videos."""

from taccel_lab.calibration.capture.camera.camera import (
    Camera,
    CameraInfo,
    CameraLostError,
    ControlLock,
    ControlValues,
    Framing,
    Gap,
    Shot,
    shots,
)
from taccel_lab.calibration.capture.camera.replay import CameraReplay, ReplayCamera, open_camera
from taccel_lab.calibration.capture.camera.uvc import Device, list_devices

__all__ = [
    "Camera",
    "CameraInfo",
    "CameraLostError",
    "CameraReplay",
    "ControlLock",
    "ControlValues",
    "Device",
    "Framing",
    "Gap",
    "ReplayCamera",
    "Shot",
    "list_devices",
    "open_camera",
    "shots",
]
