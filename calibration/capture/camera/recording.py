# SPDX-License-Identifier: Apache-2.0
"""Frames that somebody recorded, whatever holds them: the one source of all commands that read or
replay files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.importers.path_pattern import natural_key
from taccel_lab.calibration.capture.suffixes import IMAGES, VIDEOS, is_picture, is_video
from taccel_lab.errors import InputError
from taccel_lab.files.hdf5_images import hdf5_cameras, hdf5_frames, is_hdf5
from taccel_lab.files.images import read_image
from taccel_lab.files.lerobot_images import is_lerobot, lerobot_cameras, lerobot_frames
from taccel_lab.files.videos import count_frames, read_frames

HELD_BY = (
    f"a video ({', '.join(VIDEOS)}), an image ({', '.join(IMAGES)}), a folder of images, an HDF5 "
    "file of UniVTAC, a LeRobot data set"
)
"""What a recording may be."""

Frame = tuple[str, np.ndarray | InputError]
"""Name and levels, RGB uint8, shape [height_px, width_px, 3], or why they cannot be read."""


@dataclass(frozen=True)
class Recording:
    """Frames of one camera, in order."""

    source: Path
    camera: str
    """Which one, where the source has names for them."""
    count: Callable[[], int]
    """How many there are, as far as the source says; counts those of a video."""
    frames: Callable[[], Iterator[Frame]]
    names: tuple[str, ...] = ()
    """File names of images; of other sources, the file says what there is."""

    @classmethod
    def of(cls, source: Path, camera: str | None = None) -> Recording:
        """What ``source`` holds, told by its content.

        Args:
            source: ``HELD_BY``.
            camera: Name of a data set's camera, or what only one of them ends in or holds.

        Raises:
            InputError: It holds no frames, or several cameras; the message names them.
        """
        if is_hdf5(source):
            chosen, count = _chosen(hdf5_cameras(source), camera, source)
            return cls(source, chosen, lambda: count, partial(_numbered_hdf5, source, chosen))
        if is_lerobot(source):
            chosen, count = _chosen(lerobot_cameras(source), camera, source)
            return cls(source, chosen, lambda: count, partial(lerobot_frames, source, chosen))
        if camera is not None:
            raise InputError(f"{source} is of one camera; leave --camera {camera} away")
        if source.is_file() and is_video(source):
            return cls(source, "", lambda: count_frames(source)[0], partial(_of_video, source))
        if source.is_dir():
            found = [p for p in source.iterdir() if is_picture(p) and p.is_file()]
            if not found:
                raise InputError(f"{source} holds no images; {', '.join(IMAGES)} are read")
            return cls._of_images(
                source, tuple(sorted(found, key=lambda path: natural_key(path.name)))
            )
        if is_picture(source):
            return cls._of_images(source, (source,))
        raise InputError(f"{source} is none of these: {HELD_BY}")

    @classmethod
    def _of_images(cls, source: Path, images: tuple[Path, ...]) -> Recording:
        names = tuple(path.name for path in images)
        return cls(source, "", lambda: len(images), partial(_of_images, images), names)


def _chosen(cameras: Mapping[str, int], wanted: str | None, source: Path) -> tuple[str, int]:
    """The camera that is meant, and its count of frames."""
    if not cameras:
        raise InputError(f"{source} holds no images of a camera that can be read")
    if wanted is None:
        found = list(cameras)
    else:
        matches = (
            [name for name in cameras if name == wanted],
            [name for name in cameras if name.endswith((f"/{wanted}", f".{wanted}"))],
            [name for name in cameras if wanted in name],
        )
        found = next((names for names in matches if names), [])
    if len(found) == 1:
        return found[0], cameras[found[0]]
    several = "it has several" if wanted is None else f"{wanted!r} is the name of several"
    problem = several if found else f"none is called {wanted!r}"
    listed = ", ".join(found or cameras)
    raise InputError(f"{source}: name the camera by --camera; {problem}: {listed}")


def _numbered_hdf5(source: Path, name: str) -> Iterator[Frame]:
    for number, image in enumerate(hdf5_frames(source, name)):
        yield f"{number}", image


def _of_video(source: Path) -> Iterator[Frame]:
    for number, image in enumerate(read_frames(source)):
        yield f"{number}", image


def _of_images(images: tuple[Path, ...]) -> Iterator[Frame]:
    for path in images:
        try:
            yield path.name, read_image(path)
        except InputError as error:
            yield path.name, error
