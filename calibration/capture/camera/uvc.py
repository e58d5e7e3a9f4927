# SPDX-License-Identifier: Apache-2.0
"""Cameras that are plugged in: which there are, which of them is meant, and their frames through
OpenCV.

Names in ``/dev/v4l`` stay with a camera, and sysfs has serial numbers. What is set is read back:
drivers take a value without an error and keep their own.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from taccel_lab.calibration.capture.camera.camera import (
    CameraInfo,
    CameraLostError,
    ControlLock,
    ControlValues,
    Shot,
)
from taccel_lab.errors import InputError

ROOT = Path("/")


@dataclass(frozen=True)
class Device:
    """One camera that is plugged in."""

    id: str
    """Stays with the camera."""
    node: str
    """What OpenCV opens: ``/dev/videoN``."""
    name: str
    serial: str | None


def list_devices(root: Path = ROOT) -> list[Device]:
    """Cameras that are plugged in."""
    return [
        Device(
            name,
            node,
            _text(_of_node(root, node) / "name") or name,
            _serial_number(root, node),
        )
        for name, node in _stable_names(root).items()
    ]


def find_device(wanted: str, root: Path = ROOT) -> Device:
    """The camera that ``wanted`` names: its id, its serial number, a part of either that no other
    has, or a node such as ``/dev/video0``.

    Raises:
        InputError: There is none, or several; the message names those there are.
    """
    devices = list_devices(root)
    exact = [d for d in devices if wanted in (d.id, d.serial, d.node, f"{root}dev/{wanted}")]
    word = wanted.casefold()
    close = [d for d in devices if word in d.id.casefold() or word in (d.serial or "").casefold()]
    found = exact or close
    if len(found) == 1:
        return found[0]
    if not devices:
        raise InputError(
            f"--camera is {wanted!r}, but no camera is plugged in (/dev/v4l is empty). Plug it in, "
            "or give a folder of images or a video to replay"
        )
    names = "; ".join(f"{d.id} ({d.name})" for d in (found or devices))
    problem = "several cameras match it" if found else "no camera matches it"
    raise InputError(f"--camera is {wanted!r}; {problem}: {names}")


def _stable_names(root: Path) -> dict[str, str]:
    """``/dev/videoN`` of each camera by the name that stays with it.

    Names of ``by-id`` hold maker, model and serial number; those of ``by-path``, taken for cameras
    that have no other, the port that it is plugged into. Only the first node of a camera gives
    images. ``root`` is ``/``, or a folder that stands for it.
    """
    found: dict[str, str] = {}
    for kind in ("by-id", "by-path"):
        folder = root / "dev/v4l" / kind
        for link in sorted(folder.glob("*-video-index0")) if folder.is_dir() else ():
            node = link.resolve().name
            if node not in found.values():
                found[link.name] = node
    return {name: f"/dev/{node}" for name, node in found.items()}


def _of_node(root: Path, node: str) -> Path:
    """What the driver says of a camera; ``name`` is such as ``DIGIT: DIGIT``."""
    return root / "sys/class/video4linux" / Path(node).name


def _serial_number(root: Path, node: str) -> str | None:
    """Serial number of the USB device behind a node; None where it has none."""
    place = _of_node(root, node) / "device"
    with suppress(OSError):
        # The node belongs to an interface, which belongs to the device.
        for folder in (place.resolve(), *place.resolve().parents[:2]):
            serial = _text(folder / "serial")
            if serial:
                return serial
    return None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


MANUAL_EXPOSURE = 1.0
"""Entry of V4L2's menu, which OpenCV hands on."""
OLDEST_S = 5.0
"""A time stamp of the driver that is farther back is of another clock."""
NEAR = 0.02
"""Part of a value within which it counts as held: drivers round to their own steps."""


def _open_capture(node: str) -> Any:
    return cv2.VideoCapture(node, cv2.CAP_V4L2)


class UvcCamera:
    """Frames of a USB camera."""

    def __init__(
        self,
        device: Device,
        size_px: tuple[int, int] | None = None,
        *,
        open_capture: Callable[[str], Any] = _open_capture,
    ) -> None:
        """Open ``device``, with images of ``size_px`` (width, height) where that is given.

        Raises:
            CameraLostError: It does not open.
            InputError: It has no images of that size.
        """
        self.info = CameraInfo(device.id, device.name, device.serial)
        self._capture = open_capture(device.node)
        if not self._capture.isOpened():
            self._capture.release()
            raise CameraLostError(
                f"{device.name} ({device.node}) does not open; is another program using it, or may "
                "you not read it (group video)?"
            )
        # The newest frame counts, not those that waited.
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if size_px is not None:
            self._require_size(size_px)

    def _require_size(self, size_px: tuple[int, int]) -> None:
        for key, value in zip(_SIZE, size_px, strict=True):
            self._capture.set(key, value)
        got = tuple(int(self._capture.get(key)) for key in _SIZE)
        if got != size_px:
            self.close()
            raise InputError(
                f"{self.info.name} gives {got[0]}x{got[1]} px when asked for {size_px[0]}x"
                f"{size_px[1]}; v4l2-ctl --list-formats-ext lists what it has"
            )

    def lock(self, values: ControlValues) -> list[ControlLock]:
        """Switch automatic exposure, gain and white balance off, set values where given, and read
        all of them back."""
        return [
            self._held("exposure", cv2.CAP_PROP_EXPOSURE, values.exposure, _AUTO_EXPOSURE),
            self._held("gain", cv2.CAP_PROP_GAIN, values.gain, None),
            self._held(
                "white balance", cv2.CAP_PROP_WB_TEMPERATURE, values.white_balance, _AUTO_WB
            ),
        ]

    def _held(
        self, name: str, key: int, wanted: float | None, automatic: tuple[int, float] | None
    ) -> ControlLock:
        if automatic is not None:
            self._capture.set(*automatic)
            mode = self._capture.get(automatic[0])
            if mode != automatic[1]:
                text = (
                    "the camera does not say" if mode < 0 else f"the camera stays at mode {mode:g}"
                )
                return ControlLock(name, False, f"cannot be locked: {text}")
        value = self._capture.get(key) if wanted is None else wanted
        if wanted is None and value < 0 and automatic is None:
            return ControlLock(name, None, "the camera has no such control")
        self._capture.set(key, value)
        now = self._capture.get(key)
        if abs(now - value) > NEAR * max(abs(value), 1.0):
            return ControlLock(name, False, f"cannot be locked at {value:g}: it is at {now:g}")
        return ControlLock(name, True, f"locked at {now:g}")

    def read(self) -> Shot:
        """The newest frame; CameraLostError when none comes within the driver's time (10 s)."""
        done, bgr = self._capture.read()
        now = time.monotonic()
        if not done or bgr is None:
            raise CameraLostError(f"{self.info.name} gives no frames any more")
        stamp = 1e-3 * self._capture.get(cv2.CAP_PROP_POS_MSEC)
        taken = stamp if now - OLDEST_S < stamp <= now else now
        return Shot(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), taken)

    def close(self) -> None:
        """Give the device back."""
        self._capture.release()


_SIZE = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
_AUTO_EXPOSURE = (cv2.CAP_PROP_AUTO_EXPOSURE, MANUAL_EXPOSURE)
_AUTO_WB = (cv2.CAP_PROP_AUTO_WB, 0.0)
