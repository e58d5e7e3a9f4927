# SPDX-License-Identifier: Apache-2.0
"""What a detector finds of a calibration board in one image."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.folder import Frame


@dataclass(frozen=True)
class BoardView:
    """Points of one board in one image; the board's x and y run as the image's do, unmirrored."""

    name: str
    source: str
    """File the image comes from, for error messages."""
    size_px: tuple[int, int]
    """Width and height of the image."""
    index: np.ndarray
    """Column and row of each point on the board, int, shape [n, 2]."""
    uv_px: np.ndarray
    """Where it is seen, shape [n, 2]; pixel (0, 0) is the centre of the top left pixel."""
    expected: int
    """Points that the whole board has."""
    sha256: str = ""
    place: int | None = None
    """Which image of the manifest's boards it is, also counting those in which none is found; what
    is held out goes by it."""
    pitch_mm: float | None = None
    """Distance of neighbouring points, where it is known."""
    others_uv_px: tuple[np.ndarray, ...] = ()
    """Where other pictures of the same dents, or the same ones through other filters, show the
    points, each [n, 2]; what they differ by is the detector's own error."""

    def board_mm(self) -> np.ndarray:
        """Points on the board [mm], z = 0, shape [n, 3]; in units of the pitch without one."""
        pitch = 1.0 if self.pitch_mm is None else self.pitch_mm
        return np.column_stack([self.index * pitch, np.zeros(len(self.index))]).astype(np.float64)


def hashes_by_name(images: Sequence[BoardView | Frame]) -> dict[str, str]:
    """SHA-256 of each image by its name, with its folder where two are named alike."""
    names = Counter(image.name for image in images)
    return {
        image.name
        if names[image.name] == 1
        else "/".join(Path(image.source).parts[-2:]): image.sha256
        for image in images
        if image.sha256
    }
