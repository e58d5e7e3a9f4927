# SPDX-License-Identifier: Apache-2.0
"""A virtual camera: a recording or a capture folder, as a camera would show it.

A capture folder is replayed as a person records it: the untouched gel, then each press comes,
stays and goes. In between the picture is a blend of both, which no press looks like: what is
taken meanwhile was taken too early.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.camera.camera import (
    CameraInfo,
    ControlLock,
    ControlValues,
    Shot,
)
from taccel_lab.calibration.capture.camera.recording import Frame, Recording
from taccel_lab.calibration.capture.captures import CapturedPress
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import MANIFEST_NAME
from taccel_lab.errors import InputError


@dataclass(frozen=True)
class CameraReplay:
    """How stills become a stream."""

    fps: float = 25.0
    rest_s: float = 2.0
    """How long the untouched gel shows before the first press, and half as long between two."""
    hold_s: float = 1.2
    """How long each press shows."""
    blend_s: float = 0.2
    """How long a press takes to come, and to go."""
    noise_levels: float = 0.0
    """Standard deviation of read noise that is added, since a still repeats its own [levels]."""
    paced: bool = False
    """Whether frames wait for their time, as a camera's do."""


class ReplayCamera:
    """Frames from files; the same every time."""

    def __init__(
        self, path: Path, frames: Callable[[], Iterator[np.ndarray]], how: CameraReplay
    ) -> None:
        self.info = CameraInfo(str(path), f"replay of {path.name}", replayed=True)
        self._frames, self._how = frames(), how
        self._rng = np.random.default_rng(0)
        self._count, self._started = 0, time.monotonic()

    def lock(self, values: ControlValues) -> list[ControlLock]:
        """Nothing adapts in files."""
        return [
            ControlLock(name, None, "as it was recorded")
            for name in ("exposure", "gain", "white balance")
        ]

    def read(self) -> Shot | None:
        """The next frame at its own time; None at the end."""
        image = next(self._frames, None)
        if image is None:
            return None
        due = self._count / self._how.fps
        self._count += 1
        if self._how.paced:
            time.sleep(max(0.0, self._started + due - time.monotonic()))
            due = time.monotonic()
        if self._how.noise_levels > 0:
            noise = self._rng.normal(0.0, self._how.noise_levels, image.shape)
            image = np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)
        return Shot(image, due)

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
        return ReplayCamera(path, lambda: pressing(rest.image(), presses, how), how)
    recording = Recording.of(path, camera)
    return ReplayCamera(path, lambda: map(_levels, recording.frames()), how)


def _levels(frame: Frame) -> np.ndarray:
    """What a camera would have shown; a frame that cannot be read ends the replay."""
    if isinstance(frame[1], InputError):
        raise frame[1]
    return frame[1]


def pressing(
    rest: np.ndarray, presses: Sequence[CapturedPress], how: CameraReplay
) -> Iterator[np.ndarray]:
    """Frames of a session in which ``presses`` are made again on a gel that looks like ``rest``."""
    for _ in range(round(how.rest_s * how.fps)):
        yield rest
    steps = max(1, round(how.blend_s * how.fps))
    for press in presses:
        image = press.image()
        ramp = [_blend(rest, image, k / steps) for k in range(1, steps)]
        yield from ramp
        for _ in range(round(how.hold_s * how.fps)):
            yield image
        yield from reversed(ramp)
        for _ in range(round(0.5 * how.rest_s * how.fps)):
            yield rest


def _blend(one: np.ndarray, other: np.ndarray, share: float) -> np.ndarray:
    mixed = (1 - share) * one.astype(np.float32) + share * other
    return np.rint(mixed).astype(np.uint8)
