# SPDX-License-Identifier: Apache-2.0
"""Which camera, what is kept of its images, and where its controls are locked: for all commands
that read one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.camera.camera import Camera, ControlValues, Framing


@dataclass(frozen=True, kw_only=True)
class CameraFlags:
    """Flags of a camera, or of files that are replayed in its place."""

    camera: str
    """The camera: its id or serial number, or a part of either that no other has (taccel-lab
    capture devices lists them). The path of a recording (as for taccel-lab read) or of a capture
    folder is replayed instead; that of a data set may go on with the name of its camera:
    demo.hdf5/left_tactile/rgb."""
    size: str | None = None
    """Camera format, WIDTHxHEIGHT. Default: the camera's choice."""
    crop: str | None = None
    """Part of the camera's images to keep: LEFT,TOP,WIDTHxHEIGHT in pixels. Use the same for
    record and live."""
    resize: str | None = None
    """Size to reduce it to, WIDTHxHEIGHT. Use the same for record and live."""
    exposure: float | None = None
    """Exposure to lock, in the camera's units. Default: the present one."""
    gain: float | None = None
    """Gain to lock. Default: the present one."""
    white_balance: float | None = None
    """White balance to lock, usually a temperature in kelvin. Default: the present one."""

    def opener(self, paced: bool) -> Callable[[], Camera]:
        """Opens the camera; a replay keeps its frames' times when ``paced``. Raises InputError for
        a size that is none."""
        from taccel_lab.calibration.capture.camera.camera import parse_size
        from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera

        size = None if self.size is None else parse_size(self.size, "--size")
        return lambda: open_camera(self.camera, size, CameraReplay(paced=paced))

    def framing(self) -> Framing:
        """What is kept of each frame."""
        from taccel_lab.calibration.capture.camera.camera import Framing

        return Framing.parse(self.crop, self.resize)

    def values(self) -> ControlValues:
        """Where the controls are locked."""
        from taccel_lab.calibration.capture.camera.camera import ControlValues

        return ControlValues(self.exposure, self.gain, self.white_balance)
