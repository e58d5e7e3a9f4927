# SPDX-License-Identifier: Apache-2.0
"""Which cameras are plugged in, and which of them is meant.

Names in ``/dev/v4l`` stay with a camera, and sysfs has serial numbers.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

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
            _card_name(root, node) or name,
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


def _card_name(root: Path, node: str) -> str:
    """What the driver calls a camera, such as ``DIGIT: DIGIT``; empty where it says nothing."""
    return _text(root / "sys/class/video4linux" / Path(node).name / "name")


def _serial_number(root: Path, node: str) -> str | None:
    """Serial number of the USB device behind a node; None where it has none."""
    place = root / "sys/class/video4linux" / Path(node).name / "device"
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
