# SPDX-License-Identifier: Apache-2.0
"""Frames that somebody recorded, whatever holds them: the one source of all commands that read or
replay files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.foreign_images import format_words, unread_format, unread_pictures
from taccel_lab.files.hdf5_images import hdf5_cameras, hdf5_frames, is_hdf5
from taccel_lab.files.images import read_image
from taccel_lab.files.inner_path import require_inner_links
from taccel_lab.files.lerobot_images import is_lerobot, lerobot_cameras, lerobot_frames
from taccel_lab.files.videos import RecordedFrame, count_frames, read_timed_frames

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
VIDEOS = (".avi", ".mp4", ".mov", ".mkv", ".webm")


def is_picture(path: Path | str) -> bool:
    """Whether a file is an image by its ending."""
    return Path(path).suffix.lower() in IMAGES


def is_video(path: Path) -> bool:
    """Whether a file is a video by its ending."""
    return path.suffix.lower() in VIDEOS


def natural_key(path: Path | str) -> list[tuple[int, int, str]]:
    """Sort key under which ``frame_2`` comes before ``frame_10``."""
    # ASCII's alone: there are other characters that `isdigit`, but not `int`, takes for digits.
    parts = re.split(r"([0-9]+)", str(path))
    return [
        (0, int(part), "") if index % 2 else (1, 0, part.lower())
        for index, part in enumerate(parts)
    ]


HELD_BY = (
    f"a video ({', '.join(VIDEOS)}), an image ({', '.join(IMAGES)}), a folder of images, an HDF5 "
    "file of UniVTAC, a LeRobot data set"
)
"""What a recording may be."""
MOST_FPS = 1e6
"""Frames a second that somebody may state, or seconds a frame."""
MOST_REFUSED = 300
"""Frames one after another that cannot be read: 10 s of 30 frames a second."""


@dataclass(frozen=True)
class Recording:
    """Frames of one camera, in order, with their times where the source has any."""

    source: Path
    camera: str
    """Which one, where the source has names for them."""
    count: Callable[[], int]
    """How many there are, as far as the source says; counts those of a video."""
    raw: Callable[[], Iterator[RecordedFrame]]
    """Frames with the source's own clock."""
    times_of: str = ""
    """What tells their times, where anything does: a video's file, a data set, the names."""
    names: tuple[str, ...] = ()
    """File names of images; of other sources, the file says what there is."""
    fps: float | None = None
    """Frames a second that a person stated: the source's own times do not count then."""

    @classmethod
    def of(cls, source: Path, camera: str | None = None, fps: float | None = None) -> Recording:
        """What ``source`` holds, told by its content.

        Args:
            source: ``HELD_BY``.
            camera: Name of a data set's camera, or what only one of them ends in or holds.
            fps: Frames a second, in place of the times that the source tells.

        Raises:
            InputError: It holds no frames, or several cameras; the message names them.
        """
        if fps is not None and not 1 / MOST_FPS <= fps <= MOST_FPS:
            raise InputError(f"--fps must lie in 1e-6..1e6, got {fps:g}")
        made = partial(cls, source, fps=fps)
        if is_hdf5(source):
            chosen, count = _chosen(hdf5_cameras(source), camera, source)
            return made(chosen, lambda: count, partial(hdf5_frames, source, chosen))
        if is_lerobot(source):
            chosen, count = _chosen(lerobot_cameras(source), camera, source)
            frames = partial(lerobot_frames, source, chosen)
            return made(chosen, lambda: count, frames, "the data set's timestamps")
        video = source.is_file() and is_video(source)
        if camera is not None and (video or source.is_dir() or is_picture(source)):
            raise InputError(f"{source} is of one camera; leave --camera {camera} away")
        if video:
            frames = partial(_of_video, source)
            return made("", lambda: count_frames(source)[0], frames, "the video's own times")
        if source.is_dir():
            require_inner_links(source, levels=1)
            images = [p for p in source.iterdir() if is_picture(p) and p.is_file()]
            other = unread_pictures(sorted(source.iterdir()))
            if not images or other:
                holds = "no images" if not images else "images that would be left out"
                raise InputError(f"{source} holds {holds}; {', '.join(IMAGES)} are read{other}")
        elif is_picture(source):
            images = [source]
        elif (foreign := unread_format(source)) is not None:
            raise InputError(f"{source} {format_words(foreign)}")
        else:
            raise InputError(f"{source} is none of these: {HELD_BY}")
        found = _in_order(images)
        return made(
            "",
            lambda: len(found),
            partial(_of_images, found),
            "" if found[0][1] is None else "the stamps in the names",
            tuple(path.name for path, _ in found),
        )

    def frames(self, size_px: tuple[int, int] | None = None) -> Iterator[RecordedFrame]:
        """The frames, their times since the first one of their episode [s], episodes counted.

        A time is None where the source has none, and where it is not later than the last one: the
        clock stood still or was set back, and how long the gel was held meanwhile is not known.

        Args:
            size_px: Width and height that they have to have; any, but all one, when None.

        Raises:
            InputError: A frame of another size: no camera's stream has two. An image among others
                of a folder is refused by itself. ``MOST_REFUSED`` frames one after another cannot
                be read. There are none.
        """
        episode, count, number, first_s, last_s = None, -1, 0, math.nan, -math.inf
        for frame in self._readable(size_px):
            if frame.episode != episode:
                episode, count, number, first_s, last_s = (
                    frame.episode,
                    count + 1,
                    0,
                    math.nan,
                    -math.inf,
                )
            time_s = frame.time_s if self.fps is None else number / self.fps
            number += 1
            if time_s is not None:
                if math.isfinite(time_s) and time_s > last_s:
                    first_s, last_s = time_s if math.isnan(first_s) else first_s, time_s
                    time_s = round(time_s - first_s, 9)
                else:
                    time_s = None
            yield frame._replace(time_s=time_s, episode=count)
        if episode is None:
            of = f" of the camera {self.camera}" if self.camera else ""
            raise InputError(f"{self.source} holds no frames{of}; at least one is needed")

    def _readable(self, size_px: tuple[int, int] | None) -> Iterator[RecordedFrame]:
        refused = 0
        for frame in self.raw():
            image = frame.image
            if not isinstance(image, InputError):
                found = image.shape[1], image.shape[0]
                if size_px is not None and found != size_px:
                    image = InputError(
                        f"frame {frame.name} is {found[0]}x{found[1]} px; "
                        f"{size_px[0]}x{size_px[1]} px are needed"
                    )
                    if not self.names:
                        raise InputError(f"{self.source}: {image}")
                elif not self.names:
                    size_px = found
            refused = refused + 1 if isinstance(image, InputError) else 0
            if refused == MOST_REFUSED:
                raise InputError(
                    f"{self.source}: {refused} frames one after another cannot be read; the last "
                    f"one: {image}"
                )
            yield frame._replace(image=image)

    @property
    def times_from(self) -> str:
        """What tells the times of the frames; empty where nothing does."""
        return self.times_of if self.fps is None else f"--fps {self.fps:g}"


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


def _of_video(source: Path) -> Iterator[RecordedFrame]:
    for number, (time_s, image) in enumerate(read_timed_frames(source)):
        yield RecordedFrame(f"{number}", image, time_s)


def _in_order(images: list[Path]) -> Sequence[tuple[Path, float | None]]:
    """Images by their stamps where they have some, otherwise in natural order."""
    stamps = name_stamps([path.stem for path in images])
    if stamps is not None:
        return sorted(zip(images, stamps, strict=True), key=lambda image: image[1])
    return [(path, None) for path in sorted(images, key=lambda path: natural_key(path.name))]


def _of_images(images: Sequence[tuple[Path, float | None]]) -> Iterator[RecordedFrame]:
    for path, time_s in images:
        try:
            image = read_image(path)
        except InputError as error:
            image = error
        yield RecordedFrame(path.name, image, time_s)


_SECONDS = r"[123][0-9]{9}"
_STAMP = re.compile(
    rf"(?<![0-9.])(?:(?P<s>{_SECONDS})(?:\.(?P<part>[0-9]{{1,9}})|[-_](?P<ns>[0-9]{{9}}))?"
    rf"|(?P<whole>{_SECONDS}(?:[0-9]{{3}}){{1,3}}))(?![0-9])"
)


def name_stamps(names: Sequence[str]) -> list[float] | None:
    """Times [s] since the earliest, of file names without their endings, as exports of ROS bags
    have them.

    A stamp is the time since 1970 in seconds (``1699999999.033``), in seconds and nanoseconds
    (``1699999999_033000000``), or as one number of milliseconds, microseconds or nanoseconds
    (``1699999999033000000``), which its count of digits tells. Counters and dates look otherwise:
    stamps lie between 2001 and 2096, where seconds have ten digits.

    None where they are not told: unless every name has one stamp, names differ in nothing else (two
    cameras in one folder do) and no two stamps are the same.
    """
    found = [list(_STAMP.finditer(name)) for name in names]
    if not found or any(len(stamps) != 1 for stamps in found):
        return None
    around = {
        (name[: stamp.start()], name[stamp.end() :])
        for name, (stamp,) in zip(names, found, strict=True)
    }
    times = [_seconds(stamp) for (stamp,) in found]
    if len(around) > 1 or len(set(times)) < len(times):
        return None
    first = min(times)
    return [float(time - first) for time in times]


def _seconds(stamp: re.Match[str]) -> Fraction:
    """Exact, since a float holds a stamp to a quarter of a microsecond alone."""
    if stamp["whole"]:
        return Fraction(int(stamp["whole"]), 10 ** (len(stamp["whole"]) - 10))
    part = stamp["part"] or stamp["ns"] or "0"
    return int(stamp["s"]) + Fraction(int(part), 10 ** len(part))
