# SPDX-License-Identifier: Apache-2.0
"""Surface, pressure and force of tactile images of a calibrated sensor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from taccel_lab.api.any_sensor import AnySensor, reading_profile_of
from taccel_lab.errors import InputError
from taccel_lab.guards import require_shape
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.typed import typed

if TYPE_CHECKING:
    import torch

    from taccel_lab.reading.reading import Reading

    Pixels = np.ndarray | torch.Tensor
    Image = Pixels | Path | str
else:
    Pixels = Image = Any  # Judged by ``_pixels``.

Method = Literal["auto", "normals", "depth"]


@overload
def read(
    sensor: AnySensor,
    image: Pixels,
    *,
    background: Image | None = None,
    mask: np.ndarray | None = None,
    method: Method = "auto",
) -> Reading: ...
@overload
def read(
    sensor: AnySensor,
    image: Path | str,
    *,
    background: Image | None = None,
    mask: np.ndarray | None = None,
    method: Method = "auto",
) -> Any: ...
@overload
def read(
    sensor: AnySensor,
    image: Sequence[Image],
    *,
    background: Image | None = None,
    mask: np.ndarray | None = None,
    method: Method = "auto",
) -> list[Reading]: ...
@typed
def read(
    sensor: AnySensor,
    image: Image | Sequence[Image],
    *,
    background: Image | None = None,
    mask: np.ndarray | None = None,
    method: Method = "auto",
) -> Reading | list[Reading]:
    """Read depth, its standard deviation, normals, pressure and force from an image, or several.

    Long recordings are read by ``taccel-lab read``, frame by frame.

    Args:
        sensor: A profile with normals or depths, its folder, a calibration, or a sensor of the
            catalogue with a starter profile.
        image: RGB levels 0..255, [height_px, width_px, 3] or [3, height_px, width_px], an array or
            a tensor; or an image file. Several are a list of these, or a folder, whose images are
            read in natural order.
        background: The untouched sensor where it is newer than the profile's own. With a starter
            profile it is looked for beside image files.
        mask: Pixels that count, bool, [height_px, width_px].
        method: ``normals`` or ``depth``; ``auto`` takes normals where the profile has both.

    Returns:
        What the image shows. ``depth_m`` is positive in a dent and, within its interval, 0 where
        nothing touches. A list of them for a list or a folder.

    Raises:
        InputError: A profile without such a block, an image of another size or sensor, a folder
            without images, a starter profile without an untouched image.
    """
    from taccel_lab.calibration.untouched_frame import UntouchedFrame
    from taccel_lab.reading.reader import Reader

    start_warp()
    images = _each(image)
    one = images is None
    shown = [image] if one else images
    files = [Path(each) for each in shown if isinstance(each, (Path, str))]
    given = None
    if background is not None:
        is_file = isinstance(background, (Path, str))
        given = Path(background) if is_file else _pixels(background, "the background")[0]
    untouched = UntouchedFrame.of(reading_profile_of(sensor), files, given, option="background=")
    if mask is not None:
        camera = untouched.profile.camera
        require_shape("mask", mask, (camera.height_px, camera.width_px))
        mask = np.asarray(mask, bool)
    reader = Reader(
        untouched.profile,
        background=untouched.image,
        background_name=untouched.name,
        mask=mask,
        method=method,
    )
    found = [
        reader.read(*_pixels(each, "image" if one else f"image {k}"))
        for k, each in enumerate(shown)
    ]
    return found[0] if one else found


def _each(image: Any) -> list[Any] | None:
    """The images of a list or a folder; None of what is one image."""
    if isinstance(image, (Path, str)):
        if not Path(image).is_dir():
            return None
        from taccel_lab.calibration.capture.camera.recording import Recording

        names = Recording.of(Path(image)).names
        if not names:
            raise InputError(f"{image} is a data set: taccel-lab read reads it frame by frame")
        return [Path(image) / name for name in names]
    if isinstance(image, Sequence):
        if not image:
            raise InputError("the list of images is empty; give at least one")
        return list(image)
    return None


def _pixels(image: Any, name: str) -> tuple[np.ndarray, str]:
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
        several = "; several are given as a list" if levels.ndim == 4 else ""
        raise InputError(
            f"{name} has shape {list(levels.shape)}; RGB levels of shape [height, width, 3] or "
            f"[3, height, width] are needed{several}"
        )
    if levels.dtype.kind not in "uif":
        raise InputError(f"{name} holds no levels 0 to 255 but values of {levels.dtype}")
    if levels.dtype != np.uint8 and levels.max(initial=0) <= 1:
        raise InputError(f"{name} holds levels from 0 to 1; multiply it by 255")
    return levels, name
