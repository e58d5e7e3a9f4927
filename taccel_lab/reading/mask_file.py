# SPDX-License-Identifier: Apache-2.0
"""The pixels that count, from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.images import read_grey
from taccel_lab.profile import SensorProfile


def read_mask(path: Path, profile: SensorProfile) -> np.ndarray:
    """Pixels that count, from a grey image of the profile's size, bool, shape [h, w].

    Raises:
        InputError: No image, another size, or no pixel that counts.
    """
    mask = read_grey(path) > 0
    expected = (profile.camera.height_px, profile.camera.width_px)
    if mask.shape != expected or not mask.any():
        raise InputError(
            f"{path} is {mask.shape[1]}x{mask.shape[0]} px with {int(mask.sum())} "
            f"usable pixels; {expected[1]}x{expected[0]} px and some non-zero ones needed"
        )
    return mask
