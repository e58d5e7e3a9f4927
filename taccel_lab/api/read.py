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
        background: The untouched sensor where it is newer than the profile's own. With a starter
            profile it is looked for beside an image file.
        mask: Pixels that count, bool, [height_px, width_px].
        method: ``normals`` or ``depth``; ``auto`` takes normals where the profile has both.

    Raises:
        InputError: A profile without such a block, an image of another size or sensor, a starter
            profile without an untouched image.
    """
    from taccel_lab.calibration.normals.read_surface import SurfaceReader
    from taccel_lab.calibration.pressure.touch import TouchReader
    from taccel_lab.calibration.untouched_frame import UntouchedFrame

    start_warp()
    pixels, name = _pixels(image, "image")
    given = Path(background) if isinstance(background, str) else background
    if isinstance(given, np.ndarray):
        given, _ = _pixels(given, "the background")
    untouched = UntouchedFrame.of(
        reading_profile_of(sensor),
        [Path(image)] if isinstance(image, (Path, str)) else [],
        given,
        option="background=",
    )
    reader = SurfaceReader(
        untouched.profile,
        background=untouched.image,
        background_name=untouched.name,
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
