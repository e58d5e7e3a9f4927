# SPDX-License-Identifier: Apache-2.0
"""Video files, decoded frame by frame by PyAV's FFmpeg in the readers' process. PyAV is an extra:
its wheels ship x264 and x265, which are GPL.

A frame's time is its presentation time in the file: recordings of variable frame rate keep their
pauses. Pixels are as the file stores them, as those of images are: how a player would turn them is
not followed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import stream_apart
from taccel_lab.files.declared import require_few
from taccel_lab.files.regular_file import LARGEST_BYTES, require_regular_file

if TYPE_CHECKING:
    from av import Packet, VideoFrame, VideoStream
    from av.container import InputContainer


class RecordedFrame(NamedTuple):
    """A frame, when it was taken, or why it cannot be read."""

    name: str
    """Name by which the file tells it from others."""
    image: np.ndarray | InputError
    """RGB uint8, shape [height_px, width_px, 3], or why there is none."""
    time_s: float | None = None
    """When it was taken, on the file's own clock [s]; None where the file does not say."""
    episode: int = 0
    """Which take it belongs to: clocks of two have nothing to do with one another."""


MAX_FRAME_PIXELS = 1 << 25
"""Most pixels of a frame; 8K has 33.2 million."""
MAX_FRAMES = 1 << 17
"""Most frames of a video: more than an hour at 30 frames a second."""
ALLOWED = "AVI, MP4, MOV, MKV or WebM"
_OPTIONS = {
    # Of what FFmpeg reads, playlists would name other files, and addresses.
    "protocol_whitelist": "file",
    "format_whitelist": "avi,mov,mp4,matroska,webm",
}
_MOST_STATED = 1 << 31
"""Frames that a header may state; more are none of a video."""
_TOLD_FRAMES = 50
_SILENT_S = 20.0
"""Longest time without a frame. Decoders search a damaged file to its end, gigabytes of it for
minutes."""

TimedImage = tuple[float | None, np.ndarray]
"""Presentation time [s], None where the file has none, and levels, RGB uint8, shape
[height, width, 3]."""


def read_timed_frames(path: Path) -> Iterator[TimedImage]:
    """Frames of a video one after another, with their times on the file's clock.

    Raises InputError with the path when fewer than two decode, and when frames are of several
    sizes, of more than ``MAX_FRAME_PIXELS``, or more than ``MAX_FRAMES``.
    """
    return stream_apart(str(path), _frames, Path(path), by="av", limit_s=_SILENT_S)


def read_frames(path: Path) -> Iterator[np.ndarray]:
    """Levels of ``read_timed_frames`` alone; errors likewise."""
    for _, image in read_timed_frames(path):
        yield image


def count_frames(path: Path) -> tuple[int, int]:
    """How many frames of a video decode, and how many it says it has; errors as above.

    Containers that state a duration only (MKV, WebM) are taken to state as many frames as fill it
    at the mean rate of those that decode.
    """
    *_, counted = stream_apart(str(path), _counts, Path(path), by="av", limit_s=_SILENT_S)
    return counted


def _frames(path: Path) -> Iterator[TimedImage]:
    first = None
    for frame in _decoded(path):
        size = frame.width, frame.height
        first = first or size
        if size != first:
            raise InputError(
                f"{path} has frames of {first[0]}x{first[1]} and {size[0]}x{size[1]} px; all have "
                "to be of one size"
            )
        yield _time_s(frame), np.ascontiguousarray(frame.to_ndarray(format="rgb24"))


def _counts(path: Path) -> Iterator[tuple[int, int]]:
    """The count so far now and then: to count a long video may take long."""
    with _opened(path) as (container, stream):
        import av

        stated, duration_s = stream.frames, (container.duration or 0) / av.time_base
    count, first_s, last_s = 0, None, 0.0
    # Each decodes, but makes no picture.
    for frame in _decoded(path):
        count += 1
        time_s = _time_s(frame)
        if time_s is not None:
            first_s, last_s = time_s if first_s is None else first_s, time_s
        if count % _TOLD_FRAMES == 0:
            yield count, stated
    if not stated and first_s is not None and last_s > first_s:
        stated = round(duration_s * (count - 1) / (last_s - first_s))
    yield count, stated if 0 < stated < _MOST_STATED else 0


def _decoded(path: Path) -> Iterator[VideoFrame]:
    """All frames that decode: what is damaged in between is left out.

    Raises InputError for fewer than two, too many, and too large ones.
    """
    count = 0
    with _opened(path) as (container, stream):
        from av.error import FFmpegError

        for packet in _packets(container, stream):
            try:
                frames = stream.decode(packet)
            except FFmpegError:
                continue
            for frame in frames:
                count += 1
                require_few(path, "frames", count, MAX_FRAMES)
                _require_small(path, frame.width, frame.height)
                yield frame
    if count < 2:
        raise _no_video(path, count)


def _packets(container: InputContainer, stream: VideoStream) -> Iterator[Packet]:
    """Packets up to the end or to where the file is damaged; the last one is empty, which makes
    the decoder give what it holds back."""
    from av import Packet
    from av.error import FFmpegError

    try:
        yield from container.demux(stream)
    except FFmpegError:  # What was read before counts.
        last = Packet()
        last.stream, last.time_base = stream, stream.time_base or last.time_base
        yield last


@contextmanager
def _opened(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """The file and its first stream of pictures; InputError for what is no video, or without
    PyAV."""
    try:
        import av
        from av.error import FFmpegError
    except ImportError:
        raise InputError(
            f"{path} is decoded by PyAV, which is not installed: pip install 'taccel-lab[video]', "
            "or give the frames as images"
        ) from None
    path = require_regular_file(path, LARGEST_BYTES, "a video")
    try:
        # FFmpeg takes some names for addresses, never those that begin with a slash.
        container = av.open(str(path.absolute()), options=dict(_OPTIONS), metadata_errors="replace")
    except FFmpegError:
        raise _no_video(path, 0) from None
    with container:
        stream = next(iter(container.streams.video), None)
        if stream is None or not stream.codec_context:  # None to decode what it is coded in.
            raise _no_video(path, 0)
        stream.codec_context.thread_count = 1  # Each takes address space, which counts as memory.
        _require_small(path, stream.codec_context.width, stream.codec_context.height)
        yield container, stream


def _time_s(frame: VideoFrame) -> float | None:
    time_s = frame.time
    return time_s if time_s is not None and math.isfinite(time_s) else None


def _no_video(path: Path, count: int) -> InputError:
    return InputError(
        f"{path} does not decode as a video ({count} frames read); {ALLOWED} is allowed, or give "
        "the frames as images"
    )


def _require_small(path: Path, width: int, height: int) -> None:
    if width * height > MAX_FRAME_PIXELS:
        raise InputError(
            f"{path} has frames of {width} x {height} px; {MAX_FRAME_PIXELS / 1e6:.0f} megapixels "
            "are allowed"
        )
