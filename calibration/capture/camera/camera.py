# SPDX-License-Identifier: Apache-2.0
"""What a camera is to those who use one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


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
