# SPDX-License-Identifier: Apache-2.0
"""Surface, pressure and force of tactile images of a calibrated sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from taccel_lab.api.images import each_image, pixels_of
from taccel_lab.errors import InputError
from taccel_lab.guards import require_shape
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.sensors.any_sensor import AnySensor, reading_profile_of
from taccel_lab.typed import typed

if TYPE_CHECKING:
    import torch

    from taccel_lab.profile import SensorProfile
    from taccel_lab.reading.reader import Reader as ImageReader
    from taccel_lab.reading.reading import Reading

    Pixels = np.ndarray | torch.Tensor
    Image = Pixels | Path | str
else:
    Pixels = Image = Any  # Judged by ``pixels_of``.

Method = Literal["auto", "normals", "depth"]


class Reader:
    """Images of one sensor in, readings out; what no image changes is made once."""

    @typed
    def __init__(
        self,
        sensor: AnySensor,
        *,
        background: Image | None = None,
        mask: np.ndarray | None = None,
        method: Method = "auto",
        device: str = "cpu",
    ) -> None:
        """
        Args:
            sensor: As of ``read``.
            background: The untouched sensor where it is newer than the profile's own; a starter
                profile needs it.
            mask: Pixels that count, bool, [height_px, width_px].
            method: As of ``read``.
            device: Of torch, on which colours are read to heights: ``cpu``, ``cuda:0``.

        Raises:
            InputError: A profile without such a block, a starter profile without a background, a
                background or mask of another size, no such device.
        """
        start_warp()
        profile = reading_profile_of(sensor)
        self._reader = image_reader(profile, (), _given(background), mask, method, device)

    @overload
    def __call__(self, image: Sequence[Image]) -> list[Reading]: ...
    @overload
    def __call__(self, image: Any) -> Any: ...
    def __call__(self, image: Any) -> Reading | list[Reading]:
        """Read an image or several, as of ``read``; errors too."""
        return _read_by(self._reader, image)

    def stream(
        self,
        frames: Path | str | Iterable[Any],
        refused: Callable[[InputError], None] | None = None,
    ) -> Iterator[Reading]:
        """Read frames one after another, each as the loop comes to it.

        Args:
            frames: A recording as of ``taccel-lab read`` (video, folder of images, HDF5 file of
                UniVTAC, LeRobot data set), whose times a gel that relaxes is followed by; or
                images, as a camera gives them.
            refused: Told of each frame that is refused, which is then left out; without it the
                first one ends the stream.

        Raises:
            InputError: No recording, or, without ``refused``, a frame that is refused.
        """
        for image, name, time_s in _frames(frames):
            try:
                if isinstance(image, InputError):
                    raise image
                found = self._reader.read(*pixels_of(image, name), time_s)
            except InputError as error:
                if refused is None:
                    raise
                refused(error)
                continue
            yield found


def _frames(frames: Path | str | Iterable[Any]) -> Iterator[tuple[Any, str, float | None]]:
    """Image, name and time of each frame."""
    if isinstance(frames, (Path, str)):
        from taccel_lab.calibration.capture.camera.recording import Recording

        for frame in Recording.of(Path(frames)).frames():
            yield frame.image, frame.name, frame.time_s
    else:
        for number, image in enumerate(frames):
            yield image, f"frame {number}", None


@overload
def read(
    sensor: AnySensor,
    image: Pixels,
    *,
    background: Image | None = None,
    mask: np.ndarray | None = None,
    method: Method = "auto",
) -> Any: ...
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

    The last few sensors stay ready: a loop of single calls reads as fast as a ``Reader``. Long
    recordings are read by ``taccel-lab read``, frame by frame.

    Args:
        sensor: A profile with normals or depths, its folder, a calibration, or a sensor of the
            catalogue with a starter profile.
        image: RGB levels 0..255, [height_px, width_px, 3] or [3, height_px, width_px], an array or
            a tensor; or an image file. Several are a list of these, an array or tensor with one
            more axis in front, or a folder, whose images are read in natural order.
        background: The untouched sensor where it is newer than the profile's own. With a starter
            profile it is looked for beside image files.
        mask: Pixels that count, bool, [height_px, width_px].
        method: ``normals`` or ``depth``; ``auto`` takes normals where the profile has both.

    Returns:
        What the image shows. ``depth_m`` is positive in a dent and, within its interval, 0 where
        nothing touches. A list of them for several.

    Raises:
        InputError: A profile without such a block, an image of another size or sensor, a folder
            without images, a starter profile without an untouched image.
    """
    from taccel_lab.api.kept_readers import kept_reader

    start_warp()
    images = each_image(image)
    shown = [image] if images is None else images
    files = [Path(each) for each in shown if isinstance(each, (Path, str))]
    given = _given(background)

    def made(profile: SensorProfile) -> ImageReader:
        return image_reader(profile, files, given, mask, method)

    kept = kept_reader(sensor, given, mask, method, files, made)
    with kept.lock:
        return _read_by(kept.reader, image, images)


def _given(background: Any) -> np.ndarray | Path | None:
    if background is None:
        return None
    if isinstance(background, (Path, str)):
        return Path(background)
    return pixels_of(background, "the background")[0]


def image_reader(
    profile: SensorProfile,
    files: Sequence[Path],
    given: np.ndarray | Path | None,
    mask: np.ndarray | None = None,
    method: Method = "auto",
    device: str = "cpu",
    option: str = "background=",
) -> ImageReader:
    """The reader of images with a profile, for what they are read against.

    Args:
        profile: With normals or depths.
        files: Images, beside which a starter profile's untouched one is looked for.
        given: What a person gave for it.
        mask: Pixels that count, bool, [height_px, width_px].
        method: As of ``read``.
        device: Of torch.
        option: By which a person gives the untouched image.

    Raises:
        InputError: As of ``Reader``.
    """
    from taccel_lab.calibration.untouched_frame import UntouchedFrame
    from taccel_lab.reading.reader import Reader as ImageReader

    untouched = UntouchedFrame.of(profile, files, given, option=option)
    if mask is not None:
        camera = untouched.profile.camera
        require_shape("mask", mask, (camera.height_px, camera.width_px))
        mask = np.array(mask, bool)
    return ImageReader(
        untouched.profile,
        background=untouched.image,
        background_name=untouched.name,
        mask=mask,
        method=method,
        device=device,
    )


def _read_by(
    reader: ImageReader, image: Any, images: list[Any] | None = None
) -> Reading | list[Reading]:
    images = each_image(image) if images is None else images
    if images is None:
        return reader.read(*pixels_of(image, "image"))
    return [reader.read(*pixels_of(each, f"image {k}")) for k, each in enumerate(images)]
