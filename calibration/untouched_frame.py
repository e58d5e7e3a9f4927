# SPDX-License-Identifier: Apache-2.0
"""What images are read against: one rule for all commands that read.

The background of a profile counts for its own unit. A starter of the catalogue knows the colours of
another one: read against its background, an untouched gel is a press. So such a profile needs an
untouched image of the unit at hand. It is the one that a person gives, an image beside those that
are read whose name says so, or what stands still in the recording. Otherwise reading is refused.

At rest several frames agree but for their noise. A press that is held stands still, too. Which of
two states is pressed tells the profile, though it is of another unit: read against the untouched
gel, other frames are dents; read against a press, its place stands out. Each state is read both
ways against frames that clearly differ from it, and one is taken only if it is the higher one in
all of these pairs. A recording that never shows the gel at rest may pass for one with its
shallowest press: 5 of 24 made of a Mini's held presses do, and with rests between them all 24 are
read right.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.capture.camera.recording import Recording, is_picture
from taccel_lab.calibration.capture.framing import (
    BACKGROUND_NAME,
    MIN_CONTACT_LEVELS,
    contact_strength,
)
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.files.inner_path import inner_path
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.reader import Reader
from taccel_lab.reading.thumb import thumb
from taccel_lab.sensors.starters import is_starter

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.camera.recording import Recording

Fit = Callable[[np.ndarray, str], np.ndarray]
"""Makes of a file's image, which an error calls by a name, one of the profile's camera, such as by
rectification or by a crop."""
MOST_FRAMES = 128
"""Most frames that are compared, evenly picked."""
THUMB_PX = 60
"""Longer side of the small images that are compared."""
NOISE_TIMES, LEAST_LEVELS = 3.0, 2.0
"""Two small images agree up to this multiple of the change of the stillest tenth of the frames, at
least so much [levels], and never where a contact shows (``MIN_CONTACT_LEVELS``)."""
STATES, WITNESSES = 5, 8
"""Still states that are tried, those of most frames first, and frames that each is read against."""
CLEARLY = 0.3
"""Part of the largest change beyond which frames differ clearly."""
AVERAGED = 16
"""Frames that an untouched image is the mean of."""
LEAST_MARGIN, MARGIN_OF_ONE = 0.15, 0.8
"""Least margin, and over how few witnesses: 0.8 of one, 0.4 of two, 0.15 of six and more. The
untouched gel of plain and dotted Minis and of 9DTact is higher than presses by 0.42 to 0.83, 0.19
to 0.70 and 0.20 to 0.36, presses than other presses by -0.47 to 0.62, the least of six by 0.10 at
most."""
Frames = Callable[[], Iterator[tuple[str, np.ndarray]]]
"""Names and RGB levels, shape [height_px, width_px, 3] of the profile; the same each time."""


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
        # Cameras are loaded by who needs them alone.
        from taccel_lab.calibration.capture.camera.recording import Recording

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


@dataclass(frozen=True)
class StillGel:
    """The untouched gel of a recording."""

    image: np.ndarray
    """Mean of its frames, RGB levels, float32, shape [height_px, width_px, 3]."""
    names: tuple[str, ...]
    """Names of these frames, in order."""


def find_still_gel(profile: SensorProfile, frames: Frames) -> StillGel | str:
    """The untouched gel, or in words why it is not told."""
    small = _picked(frames)
    if len(small) < 3:
        return f"{len(small)} images of the profile's size"
    numbers = np.array(list(small))
    apart = _distances(list(small.values()))
    states = _states(apart)
    if not states:
        return "no two frames agree but for their noise"
    pairs = [(state, _witnesses(apart, state)) for state in states]
    pairs = [(numbers[state], numbers[others]) for state, others in pairs if len(others)]
    if not pairs:
        return "nothing changes in it"
    images = _read(frames, np.concatenate([np.concatenate(pair) for pair in pairs]))
    clearest, best = 0.0, None
    for state, others in pairs:
        own = [images[number] for number in sorted(state)]
        mean = np.asarray(np.mean([image for _, image in own], axis=0, dtype=np.float32))
        margin = _margin(profile, mean, [images[number][1] for number in others], clearest)
        if margin > clearest:
            clearest, best = margin, StillGel(mean, tuple(name for name, _ in own))
    return best or "what stands still in it may be a press that is held"


def _picked(frames: Frames) -> dict[int, np.ndarray]:
    """Small images by their numbers, evenly picked in one pass, however many there are."""
    step, small = 1, {}
    for number, (_, image) in enumerate(frames()):
        if number % step == 0:
            small[number] = thumb(image, THUMB_PX)
        if len(small) > MOST_FRAMES:
            step *= 2
            small = {n: one for n, one in small.items() if n % step == 0}
    return small


def _read(frames: Frames, wanted: np.ndarray) -> dict[int, tuple[str, np.ndarray]]:
    """Names and whole images of these numbers."""
    left, found = set(wanted.tolist()), {}
    for number, frame in enumerate(frames()):
        if number in left:
            found[number] = frame
            left.remove(number)
        if not left:
            break
    return found


def _distances(small: Sequence[np.ndarray]) -> np.ndarray:
    """Strongest change between two of them [levels], shape [frame, frame]."""
    apart = np.zeros((len(small), len(small)))
    for i, one in enumerate(small):
        for j in range(i):
            apart[i, j] = apart[j, i] = contact_strength(one - small[j])
    return apart


def _states(apart: np.ndarray) -> list[np.ndarray]:
    """Indices of frames that agree with one of them, the state of most frames first."""
    others = apart + np.diag(np.full(len(apart), np.inf))
    noise = float(np.quantile(others.min(axis=1), 0.1))
    near = apart <= min(max(NOISE_TIMES * noise, LEAST_LEVELS), MIN_CONTACT_LEVELS)
    free, states = np.ones(len(apart), dtype=bool), []
    while len(states) < STATES:
        sizes = (near & free).sum(axis=1) * free
        middle = int(np.argmax(sizes))
        if sizes[middle] < 2:
            break
        own = np.flatnonzero(near[middle] & free)
        free[own] = False
        states.append(own[np.argsort(apart[middle, own], kind="stable")][:AVERAGED])
    return states


def _witnesses(apart: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Indices of frames that clearly differ from a state and from one another, weak presses and
    strong ones."""
    away = apart[state].min(axis=0)
    least = max(2 * MIN_CONTACT_LEVELS, CLEARLY * float(away.max()))
    clear = np.flatnonzero(away > least)
    distinct: list[int] = []
    for index in clear[np.argsort(away[clear], kind="stable")]:
        if all(apart[index, other] > least for other in distinct):
            distinct.append(int(index))
    count = min(WITNESSES, len(distinct))
    return np.array(distinct, dtype=int)[np.linspace(0, len(distinct) - 1, count).astype(int)]


def _margin(
    profile: SensorProfile, rest: np.ndarray, others: Sequence[np.ndarray], enough: float
) -> float:
    """How clearly ``rest`` is higher than all others: the least of its net rises above one of them
    less that the other way, as a part of all that rises or sinks; 0 where that is not clear, or not
    more than ``enough``."""
    least = 1.0
    needed = max(LEAST_MARGIN, MARGIN_OF_ONE / len(others), enough)
    resting = Reader(profile, background=rest)
    for other in others:
        up, moved_up = _net_rise(Reader(profile, background=other), rest)
        down, moved_down = _net_rise(resting, other)
        least = min(least, (up - down) / max(moved_up + moved_down, 1e-12))
        if least < needed:
            return 0.0
    return least


def _net_rise(reader: Reader, image: np.ndarray) -> tuple[float, float]:
    """Sums over the pixels of the rise of an image above a reader's background, and of its size.

    Both of squares [mm2]: a contact is deep, what surrounds it wide.
    """
    # What lies highest is what is asked here, and no zero.
    lit = replace(reader.lit(image), rest=None)
    rise_mm = -1e3 * reader.surface(lit).depth_m
    return float((rise_mm * np.abs(rise_mm)).sum()), float(np.square(rise_mm).sum())
