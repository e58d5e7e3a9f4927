# SPDX-License-Identifier: Apache-2.0
"""A camera by what a person calls it: an id, or files to replay."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.camera.camera import Camera
from taccel_lab.calibration.capture.camera.devices import find_device
from taccel_lab.calibration.capture.camera.replay import Replay, open_replay
from taccel_lab.calibration.capture.camera.uvc import UvcCamera


def open_camera(
    wanted: str, size_px: tuple[int, int] | None = None, replay: Replay | None = None
) -> Camera:
    """The camera that ``wanted`` names.

    Args:
        wanted: Id or serial number (``find_device``), or the path of a video, of a folder of images
            or of a capture folder.
        size_px: Width and height that a device is asked for.
        replay: How stills are shown.

    Raises:
        InputError: There is none.
        CameraLostError: It does not open.
    """
    path = Path(wanted)
    if path.is_dir() or (path.is_file() and not wanted.startswith("/dev/")):
        return open_replay(path, replay)
    return UvcCamera(find_device(wanted), size_px)
