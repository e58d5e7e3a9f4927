# SPDX-License-Identifier: Apache-2.0
"""Cameras: of a sensor that is plugged in, or replayed from images and videos."""

from taccel_lab.calibration.capture.camera.camera import (
    Camera,
    CameraInfo,
    CameraLostError,
    ControlLock,
    ControlValues,
    Shot,
)
from taccel_lab.calibration.capture.camera.devices import Device, list_devices
from taccel_lab.calibration.capture.camera.framing import Framing
from taccel_lab.calibration.capture.camera.open_camera import open_camera
from taccel_lab.calibration.capture.camera.replay import CameraReplay, ReplayCamera
from taccel_lab.calibration.capture.camera.shots import Gap, shots

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
