# SPDX-License-Identifier: Apache-2.0
"""Videos of the gel: a file that PyAV decodes, or numbered images."""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path

from taccel_lab.calibration.capture.folder import Frame, MarkerCaptures, Video
from taccel_lab.calibration.capture.records import read_columns
from taccel_lab.calibration.capture.schema import MarkersEntry, VideoEntry
from taccel_lab.errors import InputError
from taccel_lab.files.images import KeptImages
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.files.videos import count_frames, read_frames

LOST_SHARE = 0.95
"""Share of the frames that a file states, of which as many have to decode."""


def load_markers(
    images: KeptImages, folder: Path, entry: MarkersEntry, background: Frame | None
) -> MarkerCaptures:
    """The dots at rest and their videos; InputError when there is no picture of dots at all."""
    rest = background if entry.rest is None else image_frame(images, folder, entry.rest)
    of_labels = None
    if entry.labels_image is not None:
        of_labels = image_frame(images, folder, entry.labels_image)
    if rest is None and of_labels is None and not entry.videos:
        raise InputError(
            f"{folder}: markers need an image at rest (markers.rest or background), or a video"
        )
    videos = tuple(load_video(images, folder, video) for video in entry.videos)
    labels = {} if entry.labels is None else read_columns(inner_path(folder, entry.labels))
    missing = {"u_px", "v_px", "du_px", "dv_px"} - labels.keys()
    if labels and missing:
        raise InputError(f"{folder / str(entry.labels)} lacks {', '.join(sorted(missing))}")
    return MarkerCaptures(rest, entry.pitch_x_mm, entry.pitch_y_mm, videos, labels, of_labels)


def image_frame(images: KeptImages, folder: Path, name: str) -> Frame:
    """An image file; InputError where it cannot be decoded."""
    path = inner_path(folder, name)
    images.read(path)
    return Frame(path.stem, str(path), file_sha256(path), partial(images.read, path))


def load_video(images: KeptImages, folder: Path, entry: VideoEntry) -> Video:
    """One motion; InputError when it does not decode or holds fewer than two frames."""
    if (entry.file is None) == (not entry.frames):
        raise InputError(f"{folder}: a video needs either a file or frames, and not both")
    if entry.file is not None:
        path = inner_path(folder, entry.file)
        count, stated = count_frames(path)
        read = partial(read_frames, path)
        return Video(entry, str(path), file_sha256(path), count, read, stated)
    paths = [path for name in entry.frames for path in _expand(folder, name)]
    if len(paths) < 2:
        raise InputError(f"{folder}: a video needs at least 2 frames, found {len(paths)}")
    digest = hashlib.sha256("".join(file_sha256(path) for path in paths).encode()).hexdigest()
    return Video(entry, str(paths[0]), digest, len(paths), lambda: map(images.read, paths))


def cut_short(video: Video) -> str | None:
    """Says so when clearly fewer frames decode than the file states; None when all do."""
    if video.frame_count >= LOST_SHARE * video.stated_count:
        return None
    return (
        f"{video.source}: {video.frame_count} of the {video.stated_count} frames that it states "
        "can be read: the file is damaged or was not closed"
    )


def _expand(folder: Path, name: str) -> list[Path]:
    """Files of a name, which may hold wildcards."""
    wild = any(c in name for c in "*?[")
    paths = sorted(folder.glob(name)) if wild else [folder / name]
    return [inner_path(folder, path.relative_to(folder).as_posix()) for path in paths]
