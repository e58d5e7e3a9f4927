# SPDX-License-Identifier: Apache-2.0
"""A camera by what a person calls it: an id, or files that a virtual camera replays.

A recording is shown as a camera would show it. A capture folder is replayed as a person records it:
the untouched gel, then each press comes, stays and goes. In between the picture is a blend of both,
which no press looks like: what is taken meanwhile was taken too early.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.camera.camera import (
    Camera,
    CameraInfo,
    ControlLock,
    ControlValues,
    Shot,
)
from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.calibration.capture.camera.uvc import UvcCamera, find_device
from taccel_lab.calibration.capture.captures import CapturedPress
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import MANIFEST_NAME
from taccel_lab.errors import InputError
from taccel_lab.files.hdf5_images import is_hdf5
from taccel_lab.files.lerobot_images import is_lerobot
from taccel_lab.files.videos import RecordedFrame


@dataclass(frozen=True)
class CameraReplay:
    """How stills become a stream."""

    fps: float = 25.0
    """Rate of frames whose times are not known."""
    rest_s: float = 2.0
    """How long the untouched gel shows before the first press, and half as long between two."""
    hold_s: float = 1.2
    """How long each press shows."""
    blend_s: float = 0.2
    """How long a press takes to come, and to go."""
    noise_levels: float = 0.0
    """Standard deviation of read noise that is added, since a still repeats its own [levels]."""
    paced: bool = False
    """Frames wait for their time, as a camera's do; photos, which have none, never do."""
    unread: Callable[[str], None] | None = None
    """Listener for frames that cannot be read, which are then left out; without one they end it."""


class ReplayCamera:
    """Frames from files; the same every time."""

    def __init__(
        self, path: Path, frames: Callable[[], Iterator[RecordedFrame]], how: CameraReplay
    ) -> None:
        self.info = CameraInfo(str(path), f"replay of {path.name}", replayed=True)
        self._frames, self._how = frames(), how
        self._rng = np.random.default_rng(0)
        self._due_s, self._started = -1.0 / how.fps, time.monotonic()
        self._last: RecordedFrame | None = None

    def lock(self, values: ControlValues) -> list[ControlLock]:
        """Nothing adapts in files."""
        return [
            ControlLock(name, None, "as it was recorded")
            for name in ("exposure", "gain", "white balance")
        ]

    def read(self) -> Shot | None:
        """The next frame at its own time; None at the end. Raises InputError for a frame that
        cannot be read, unless ``CameraReplay.unread`` takes it."""
        for frame in self._frames:
            if not isinstance(frame.image, InputError):
                return self._shot(frame, frame.image)
            if self._how.unread is None:
                raise frame.image
            self._how.unread(str(frame.image))
        return None

    def _shot(self, frame: RecordedFrame, image: np.ndarray) -> Shot:
        due = self._due_s = self._next_s(frame)
        if self._how.paced:
            time.sleep(max(0.0, self._started + due - time.monotonic()))
            due = time.monotonic()
        if self._how.noise_levels > 0:
            noise = self._rng.normal(0.0, self._how.noise_levels, image.shape)
            image = np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)
        return Shot(image, due)

    def _next_s(self, frame: RecordedFrame) -> float:
        """When a frame is due [s] since the first one."""
        last, self._last = self._last, frame
        if last is None or frame.episode != last.episode:
            return self._due_s + 1.0 / self._how.fps
        if last.time_s is None or frame.time_s is None:
            return self._due_s + 1.0 / self._how.fps
        return self._due_s + frame.time_s - last.time_s

    def close(self) -> None:
        """There are no more frames."""
        self._frames = iter(())


def open_replay(
    path: Path, how: CameraReplay | None = None, camera: str | None = None
) -> ReplayCamera:
    """A camera that replays a capture folder, or a recording (``camera``: which one of it).

    Raises:
        InputError: Nothing in ``path`` can be shown.
    """
    how = how or CameraReplay()
    if (path / MANIFEST_NAME).is_file():
        folder = load_capture_folder(path)
        rest, presses = folder.background, folder.presses
        if rest is None or not presses:
            raise InputError(
                f"{path}: a capture folder is replayed from its background and its presses"
            )
        still = rest.image()
        return ReplayCamera(
            path, lambda: (RecordedFrame("", i) for i in pressing(still, presses, how)), how
        )
    recording = Recording.of(path, camera)
    how = replace(how, paced=how.paced and bool(recording.times_of))
    return ReplayCamera(path, recording.frames, how)


def pressing(
    rest: np.ndarray, presses: Sequence[CapturedPress], how: CameraReplay
) -> Iterator[np.ndarray]:
    """Frames of a session in which ``presses`` are made again on a gel that looks like ``rest``."""
    for _ in range(round(how.rest_s * how.fps)):
        yield rest
    steps = max(1, round(how.blend_s * how.fps))
    for press in presses:
        image = press.image()
        # Levels between the two, a step further each.
        ramp = [
            np.rint((1 - k / steps) * rest.astype(np.float32) + k / steps * image).astype(np.uint8)
            for k in range(1, steps)
        ]
        yield from ramp
        for _ in range(round(how.hold_s * how.fps)):
            yield image
        yield from reversed(ramp)
        for _ in range(round(0.5 * how.rest_s * how.fps)):
            yield rest


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
