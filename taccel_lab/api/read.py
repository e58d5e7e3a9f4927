# SPDX-License-Identifier: Apache-2.0
"""Surface, pressure and force of one tactile image of a calibrated sensor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from taccel_lab.api.sensor import AnySensor, reading_profile_of
from taccel_lab.errors import InputError
from taccel_lab.processes.start_warp import start_warp

if TYPE_CHECKING:
    from taccel_lab.calibration.pressure.touch import TouchReading


def read(
    sensor: AnySensor,
    image: np.ndarray | Path | str,
    *,
    background: np.ndarray | Path | str | None = None,
    mask: np.ndarray | None = None,
    method: Literal["auto", "normals", "depth"] = "auto",
) -> TouchReading:
    """Read height, its standard deviation, normals, pressure and force from an image.

    Many images of one sensor: ``TouchReader``, which prepares once what all of them share.

    Args:
        sensor: A profile with normals or depths, its folder, or a calibration.
        image: RGB levels, uint8, [height_px, width_px, 3], or an image file.
        background: The untouched sensor where it is newer than the profile's own.
        mask: Pixels that count, bool, [height_px, width_px].
        method: ``normals`` or ``depth``; ``auto`` takes normals where the profile has both.

    Raises:
        InputError: A profile without such a block, an image of another size or sensor.
    """
    from taccel_lab.calibration.normals.read_surface import SurfaceReader
    from taccel_lab.calibration.pressure.touch import TouchReader

    start_warp()
    pixels, name = _pixels(image, "image")
    untouched, background_name = None, "the background"
    if background is not None:
        untouched, background_name = _pixels(background, "the background")
    reader = SurfaceReader(
        reading_profile_of(sensor),
        background=untouched,
        background_name=background_name,
        mask=mask,
        method=method,
    )
    return TouchReader(reader).read(pixels, name)


def _pixels(image: np.ndarray | Path | str, name: str) -> tuple[np.ndarray, str]:
    """Levels of an image, and what errors call it."""
    if isinstance(image, (Path, str)):
        from taccel_lab.files.images import read_image

        return read_image(Path(image)), str(image)
    if image.ndim != 3 or image.shape[2] != 3:
        raise InputError(
            f"{name} has shape {list(image.shape)}; RGB levels of shape [height, width, 3] are "
            "needed"
        )
    return image, name
