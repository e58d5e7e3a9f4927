# SPDX-License-Identifier: Apache-2.0
"""The frames of a camera, across disconnects."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass

from taccel_lab.calibration.capture.camera.camera import Camera, CameraLostError, Shot
from taccel_lab.errors import InputError

AGAIN_S = 1.0
"""Time between two tries to open a camera that is gone [s]."""


@dataclass(frozen=True)
class Gap:
    """The camera is not there."""

    reason: str


def shots(
    open_: Callable[[], Camera],
    opened: Callable[[Camera], None],
    *,
    again_s: float = AGAIN_S,
) -> Generator[Shot | Gap, None, None]:
    """Frames, and a ``Gap`` each time that a lost camera could not be opened again.

    The first time it has to open. The generator ends with a replay, and closes the camera when it
    is closed.

    ``opened`` is called with the camera each time, for instance to lock its controls; ``again_s``
    passes between two tries.

    Raises:
        InputError: There is no such camera at first.
        CameraLostError: It does not open at first.
    """
    camera: Camera | None = open_()
    opened(camera)
    try:
        while True:
            while camera is None:
                try:
                    camera = open_()
                    opened(camera)
                except (CameraLostError, InputError) as error:
                    yield Gap(str(error))
                    time.sleep(again_s)
            try:
                shot = camera.read()
            except CameraLostError as error:
                camera.close()
                camera = None
                yield Gap(str(error))
                continue
            if shot is None:
                return
            yield shot
    finally:
        if camera is not None:
            camera.close()
