# SPDX-License-Identifier: Apache-2.0
"""Which cameras are plugged in, and which of them is meant."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.camera.v4l2 import (
    SizedFormat,
    card_name,
    serial_number,
    sized_formats,
    stable_names,
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
    formats: tuple[SizedFormat, ...] = ()


def list_devices(root: Path = ROOT) -> list[Device]:
    """Cameras that are plugged in."""
    return [
        Device(
            name,
            node,
            card_name(root, node) or name,
            serial_number(root, node),
            tuple(sized_formats(node)) if root == ROOT else (),
        )
        for name, node in stable_names(root).items()
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
