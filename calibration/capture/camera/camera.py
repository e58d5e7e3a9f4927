# SPDX-License-Identifier: Apache-2.0
"""What a camera is to those who use one, the part of its frames that is kept, and its frames across
disconnects.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from taccel_lab.errors import InputError


class CameraLostError(Exception):
    """The camera gives no frames any more: it was unplugged, or its driver gave up."""


@dataclass(frozen=True)
class Shot:
    """One frame."""

    image: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]."""
    time_s: float
    """When it was taken, on the clock of ``time.monotonic``; of a replay, its own time."""


@dataclass(frozen=True)
class ControlLock:
    """One control that has to stand still while a sensor is calibrated."""

    name: str
    """``exposure``, ``gain`` or ``white balance``."""
    held: bool | None
    """Whether the camera says that it holds it; None where it has no such control to be asked."""
    text: str
    """Value, or why not, in words."""

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


@dataclass(frozen=True)
class ControlValues:
    """Values to lock at, in the camera's own units; None: as they are."""

    exposure: float | None = None
    gain: float | None = None
    white_balance: float | None = None


@dataclass(frozen=True)
class CameraInfo:
    """Which camera it is."""

    id: str
    """Identifier by which the camera is found again."""
    name: str
    serial: str | None = None
    replayed: bool = False
    """Whether frames come from files."""


class Camera(Protocol):
    """A source of frames, open until ``close``."""

    @property
    def info(self) -> CameraInfo: ...

    def lock(self, values: ControlValues) -> list[ControlLock]:
        """Switch automatic settings off, and say for each control whether that held."""
        ...

    def read(self) -> Shot | None:
        """The next frame; None at the end of a replay.

        Raises:
            CameraLostError: There are no more frames, though there should be.
        """
        ...

    def close(self) -> None: ...


_PART = re.compile(r"^([0-9]{1,6}),([0-9]{1,6}),([0-9]{1,6})x([0-9]{1,6})$")
_SIZE = re.compile(r"^([0-9]{1,6})x([0-9]{1,6})$")
SQUARE = 0.02
"""How unevenly rows and columns may be made smaller: pixels would no longer be square."""


def parse_size(text: str, option: str) -> tuple[int, int]:
    """``320x240`` as width and height [px]; InputError names ``option``."""
    found = _SIZE.match(text)
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if min(size) < 32:
        raise InputError(
            f"{option} is {text!r}; WIDTHxHEIGHT is allowed, at least 32x32, as 640x480"
        )
    return size


@dataclass(frozen=True)
class Framing:
    """Cut, then make smaller; neither when None."""

    part: tuple[int, int, int, int] | None = None
    """Left, top, width and height [px]."""
    size_px: tuple[int, int] | None = None
    """Width and height afterwards."""

    @classmethod
    def parse(cls, crop: str | None, resize: str | None) -> Framing:
        """Reads ``LEFT,TOP,WIDTHxHEIGHT`` and ``WIDTHxHEIGHT``; InputError for anything else."""
        part = None
        if crop is not None:
            found = _PART.match(crop)
            if found is None:
                raise InputError(f"--crop is {crop!r}; LEFT,TOP,WIDTHxHEIGHT in pixels is allowed")
            left, top, width, height = (int(value) for value in found.groups())
            part = (left, top, width, height)
        return cls(part, None if resize is None else parse_size(resize, "--resize"))

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The image as it is kept, RGB uint8; InputError where it has no such part."""
        if self.part is not None:
            left, top, width, height = self.part
            if left + width > image.shape[1] or top + height > image.shape[0]:
                raise InputError(
                    f"--crop reaches to ({left + width}, {top + height}) px; the camera's images "
                    f"have {image.shape[1]}x{image.shape[0]}"
                )
            image = image[top : top + height, left : left + width]
        if self.size_px is None or self.size_px == image.shape[1::-1]:
            return np.ascontiguousarray(image)
        ratios = [have / want for have, want in zip(image.shape[1::-1], self.size_px, strict=True)]
        if min(ratios) < 1 or abs(ratios[0] / ratios[1] - 1) > SQUARE:
            raise InputError(
                f"--resize to {self.size_px[0]}x{self.size_px[1]} px does not fit images of "
                f"{image.shape[1]}x{image.shape[0]}: they are made smaller only, both sides alike; "
                "cut them with --crop first"
            )
        return cv2.resize(image, self.size_px, interpolation=cv2.INTER_AREA)

    def __str__(self) -> str:
        words = []
        if self.part is not None:
            left, top, width, height = self.part
            words.append(f"the part {left},{top},{width}x{height}")
        if self.size_px is not None:
            words.append("made smaller to {}x{} px".format(*self.size_px))
        return ", ".join(words) or "whole images"


AGAIN_S = 1.0
"""Time between two tries to open a camera that is gone [s]."""


@dataclass(frozen=True)
class Gap:
    """The camera is not there."""

    reason: str


def shots(
    open_: Callable[[], Camera], opened: Callable[[Camera], None]
) -> Generator[Shot | Gap, None, None]:
    """Frames, and a ``Gap`` each time that a lost camera could not be opened again.

    The first time it has to open. The generator ends with a replay, and closes the camera when it
    is closed.

    ``opened`` is called with the camera each time, for instance to lock its controls.

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
                    time.sleep(AGAIN_S)
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
