# SPDX-License-Identifier: Apache-2.0
"""Images of a profile as the files that other tools read: 8 bit, RGB levels of 255."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from taccel_lab.files.atomic_file import write_image


def eight_bit(rgb: np.ndarray) -> np.ndarray:
    """Levels rounded to uint8, same shape."""
    return np.clip(np.rint(rgb), 0, 255).astype(np.uint8)


def write_rgb(path: Path, rgb: np.ndarray, parameters: Sequence[int] = ()) -> None:
    """Write an RGB image [h, w, 3]; the suffix says the format, ``parameters`` are OpenCV's."""
    write_image(path, np.ascontiguousarray(eight_bit(rgb)[..., ::-1]), parameters)
