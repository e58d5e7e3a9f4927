# SPDX-License-Identifier: Apache-2.0
"""A camera by what a person calls it: an id, or files to replay."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.camera.camera import Camera
from taccel_lab.calibration.capture.camera.devices import find_device
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_replay
from taccel_lab.calibration.capture.camera.uvc import UvcCamera
from taccel_lab.files.hdf5_images import is_hdf5
from taccel_lab.files.lerobot_images import is_lerobot


def open_camera(
    wanted: str, size_px: tuple[int, int] | None = None, replay: CameraReplay | None = None
) -> Camera:
    """The camera that ``wanted`` names.

    Args:
        wanted: Id or serial number (``find_device``), or the path of a recording or of a capture
            folder. The path of a data set may go on with the name of its camera.
        size_px: Width and height that a device is asked to give.
        replay: How stills are shown.

    Raises:
        InputError: There is none.
        CameraLostError: It does not open.
    """
    files = replayed_files(wanted)
    if files is not None:
        return open_replay(files[0], replay, files[1])
    return UvcCamera(find_device(wanted), size_px)


def replayed_files(wanted: str) -> tuple[Path, str | None] | None:
    """The path that ``wanted`` names, and which camera of it; None for a device."""
    path = Path(wanted)
    if wanted.startswith("/dev/"):
        return None
    if path.exists():
        return path, None
    for folder in path.parents:
        if is_hdf5(folder) or is_lerobot(folder):
            return folder, path.relative_to(folder).as_posix()
    return None
