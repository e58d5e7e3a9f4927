# SPDX-License-Identifier: Apache-2.0
"""What a stranger may put into a folder that others go on with, copy or read."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

SECRET = "not yours"
REFUSED = r"link|no regular file|cannot be followed|does not exist"
LURES = ("link out", "link to a folder", "link to nothing", "circle", "device", "pipe")


def lure(place: Path, kind: str, outside: Path) -> Path:
    """Put something that leads elsewhere at ``place``, whatever was there; returns a file in the
    folder ``outside`` that must stay as it is."""
    outside.mkdir(exist_ok=True)
    secret = outside / ".secret.png"
    secret.write_text(SECRET)
    if place.is_dir() and not place.is_symlink():
        shutil.rmtree(place)
    place.unlink(missing_ok=True)
    place.parent.mkdir(parents=True, exist_ok=True)
    if kind == "pipe":
        os.mkfifo(place)
        return secret
    leads = {
        "link out": secret,
        "link to a folder": outside,
        "link to nothing": "nowhere",
        "circle": place.name,
        "device": "/dev/zero",
    }
    place.symlink_to(leads[kind])
    return secret


class Payload:
    """Makes the folder ``place`` when it is unpickled."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, (str(self.place),)
