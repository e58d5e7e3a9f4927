# SPDX-License-Identifier: Apache-2.0
"""Image files that several steps of a command look at, each decoded once."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.files.images import read_image

KEPT_BYTES = 512 << 20
"""Most bytes of levels that are held: 2,300 images of 320x240 px, 580 of 640x480 px."""


class KeptImages:
    """Images by path, read when they are first asked for and held while there is room.

    Images beyond ``limit_bytes`` are decoded each time: those that came first stay, since steps
    that go through all images in one order would find nothing of the latest ones.
    """

    def __init__(self, limit_bytes: int = KEPT_BYTES) -> None:
        self._room = limit_bytes
        self._kept: dict[Path, np.ndarray] = {}

    def read(self, path: Path) -> np.ndarray:
        """RGB uint8 of shape [height, width, 3], read-only; errors as of ``read_image``."""
        image = self._kept.get(path)
        if image is None:
            image = read_image(path)
            image.flags.writeable = False
            if image.nbytes <= self._room:
                self._room -= image.nbytes
                self._kept[path] = image
        return image
