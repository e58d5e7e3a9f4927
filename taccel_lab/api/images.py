# SPDX-License-Identifier: Apache-2.0
"""Images as a script holds them: arrays, tensors, files, folders, and several of these."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError


def each_image(image: Any) -> list[Any] | None:
    """The images of a list, a folder or an array with an axis for them; None of what is one
    image. InputError where there are none."""
    if isinstance(image, (Path, str)):
        if not Path(image).is_dir():
            return None
        from taccel_lab.calibration.capture.camera.recording import Recording

        names = Recording.of(Path(image)).names
        if not names:
            raise InputError(f"{image} is a data set: taccel-lab read reads it frame by frame")
        return [Path(image) / name for name in names]
    if isinstance(image, Sequence) or getattr(image, "ndim", 0) == 4:
        if not len(image):
            raise InputError("the list of images is empty; give at least one")
        return list(image)
    return None


def pixels_of(image: Any, name: str) -> tuple[np.ndarray, str]:
    """Levels of an image, and what errors call it."""
    if isinstance(image, (Path, str)):
        from taccel_lab.files.images import read_image

        return read_image(Path(image)), str(image)
    if hasattr(image, "detach"):
        image = image.detach().cpu()
    levels: np.ndarray
    try:
        levels = np.asarray(image)
    except ValueError:  # A list of lists of unequal lengths.
        levels = np.empty(0, object)
    if levels.ndim == 3 and levels.shape[0] == 3 != levels.shape[2]:
        levels = np.moveaxis(levels, 0, 2)
    if levels.ndim != 3 or levels.shape[2] != 3:
        raise InputError(
            f"{name} has shape {list(levels.shape)}; RGB levels of shape [height, width, 3] or "
            f"[3, height, width] are needed"
        )
    if levels.dtype.kind not in "uif":
        raise InputError(f"{name} holds no levels 0 to 255 but values of {levels.dtype}")
    if levels.dtype.kind == "f" and not np.isfinite(levels).all():
        raise InputError(f"{name} holds levels that are NaN or infinite; 0 to 255 are allowed")
    if levels.dtype != np.uint8 and levels.max(initial=0) <= 1:
        raise InputError(f"{name} holds levels from 0 to 1; multiply it by 255")
    return levels, name
