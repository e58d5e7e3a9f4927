# SPDX-License-Identifier: Apache-2.0
"""What images are read against: one rule for all commands that read.

The background of a profile counts for its own unit. A starter of the catalogue knows the colours of
another one: read against its background, an untouched gel is a press. So such a profile needs an
untouched image of the unit at hand. It is the one that a person gives, an image beside those that
are read whose name says so, or what stands still in the recording (``still_gel``). Otherwise
reading is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.camera.recording import Recording, is_picture
from taccel_lab.calibration.capture.framing import BACKGROUND_NAME
from taccel_lab.calibration.still_gel import find_still_gel
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.files.inner_path import inner_path
from taccel_lab.profile import SensorProfile
from taccel_lab.sensors.starters import is_starter

Fit = Callable[[np.ndarray, str], np.ndarray]
"""Makes of a file's image, which an error calls by a name, one of the profile's camera, such as by
rectification or by a crop."""


def _as_it_is(image: np.ndarray, _: str) -> np.ndarray:
    return image


class _NotFound(Exception):
    """No untouched image is found; why, to go on a sentence with."""


@dataclass(frozen=True)
class UntouchedFrame:
    """What images are read against."""

    profile: SensorProfile
    """Whose remarks say where the image was found, if it was."""
    image: np.ndarray | None = None
    """RGB levels, shape [height_px, width_px, 3]; None: the profile's own background."""
    name: str = "the background"
    """How an error calls it."""

    @classmethod
    def of(
        cls,
        profile: SensorProfile,
        sources: Sequence[Path],
        given: Path | np.ndarray | None = None,
        *,
        fit: Fit = _as_it_is,
        camera: str | None = None,
        option: str = "--background",
    ) -> UntouchedFrame:
        """The image that images of ``sources`` are read against.

        Args:
            profile: That they are read with.
            sources: Images of one folder, or a recording; none for an image that has no file.
            given: What a person gave for it.
            fit: Of every image; its InputError leaves an image out.
            camera: Of a data set, as of ``Recording.of``.
            option: By which a person gives it.

        Raises:
            InputError: The profile is of another unit, and no untouched image is found.
        """
        if isinstance(given, np.ndarray):
            return cls(profile, given)
        if given is not None:
            return cls(profile, fit(read_image(given), str(given)), str(given))
        if not is_starter(profile):
            return cls(profile)
        try:
            return cls._beside(profile, sources, fit, camera)
        except _NotFound as error:
            raise InputError(
                f"the profile of {profile.sensor.name} is of another unit{error}; give an image of "
                f"your untouched sensor: {option}"
            ) from None

    @classmethod
    def _beside(
        cls, profile: SensorProfile, sources: Sequence[Path], fit: Fit, camera: str | None
    ) -> UntouchedFrame:
        folders = {path if path.is_dir() else path.parent for path in sources}
        if len(folders) != 1:
            raise _NotFound(" and the images are of several folders" if folders else "")
        folder = folders.pop()
        frames = partial(_frames, profile, fit)
        named = list(_named(profile, folder, fit))
        if len(named) > 1:  # Which is of this unit and day, nobody says.
            names = ", ".join(path.name for path, _ in named)
            raise _NotFound(f" and {folder} has several images called untouched ({names})")
        for path, image in named:
            return cls._found(profile, image, str(path), f"{path}, by its name")
        pictures = all(path.is_file() and is_picture(path) for path in sources)
        recording = Recording.of(folder if pictures else sources[0], camera)
        still = find_still_gel(profile, partial(frames, recording))
        if isinstance(still, str):
            raise _NotFound(f" and {recording.source} shows no untouched gel for certain ({still})")
        name = f"{len(still.names)} still frames of {recording.source}"
        said = f"{name}, {still.names[0]} to {still.names[-1]}"
        return cls._found(profile, still.image, name, said)

    @classmethod
    def _found(
        cls, profile: SensorProfile, image: np.ndarray, name: str, said: str
    ) -> UntouchedFrame:
        stated = profile.sensor.provenance
        remarks = (*stated.remarks, f"untouched gel: {said}")
        provenance = stated.model_copy(update={"remarks": remarks})
        marked = profile.with_block(profile.sensor.replace(provenance=provenance))
        return replace(cls(marked), image=image, name=name)


def _named(profile: SensorProfile, folder: Path, fit: Fit) -> Iterator[tuple[Path, np.ndarray]]:
    """Images of a folder whose names say that they are untouched."""
    for path in sorted(folder.iterdir()):
        if is_picture(path) and BACKGROUND_NAME.search(path.stem) and path.is_file():
            image = _fitted(profile, read_image(inner_path(folder, path.name)), path.name, fit)
            if image is not None:
                yield path, image


def _frames(
    profile: SensorProfile, fit: Fit, recording: Recording
) -> Iterator[tuple[str, np.ndarray]]:
    for frame in recording.frames():
        image = _fitted(profile, frame.image, frame.name, fit)
        if image is not None:
            yield frame.name, image
        elif not recording.names and isinstance(frame.image, np.ndarray):
            # All that follow have its size.
            height, width = frame.image.shape[:2]
            camera = profile.camera
            raise InputError(
                f"{recording.source}: frame {frame.name} is {width}x{height} px; the profile's "
                f"camera has {camera.width_px}x{camera.height_px} px"
            )


def _fitted(
    profile: SensorProfile, image: np.ndarray | InputError, name: str, fit: Fit
) -> np.ndarray | None:
    """An image as the profile's camera has it; None for one that cannot be read, or of another
    size."""
    if isinstance(image, InputError):
        return None
    try:
        fitted = fit(image, name)
    except InputError:
        return None
    camera = profile.camera
    return fitted if fitted.shape == (camera.height_px, camera.width_px, 3) else None
