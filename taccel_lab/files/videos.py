# SPDX-License-Identifier: Apache-2.0
"""Video files, decoded frame by frame by OpenCV's FFmpeg in the readers' process.

OpenCV's wheels decode no AV1, in which LeRobot's data sets are coded: PyAV does that. Pixels are as
the file stores them, as those of images are: how a player would turn them is not followed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import CAPTURE_OPTIONS, ENVIRONMENT, stream_apart
from taccel_lab.files.regular_file import LARGEST_BYTES, require_regular_file

if TYPE_CHECKING:
    import cv2
    from av import VideoFrame

MAX_FRAME_PIXELS = 1 << 25
"""Of a frame; 8K has 33.2 million."""
MAX_FRAMES = 1 << 17
"""Of a video: more than an hour at 30 frames a second."""
ALLOWED = "AVI, MP4, MOV, MKV or WebM"
_TOLD_FRAMES = 50
_SILENT_S = 20.0
"""Without a frame. Decoders search a damaged file to its end, gigabytes of it for minutes."""


def read_frames(path: Path) -> Iterator[np.ndarray]:
    """Frames of a video one after another, RGB uint8, each of shape [height, width, 3].

    Raises InputError with the path when fewer than two decode, and when frames are of several
    sizes, of more than ``MAX_FRAME_PIXELS``, or more than ``MAX_FRAMES``.
    """
    return stream_apart(str(path), _frames, Path(path), by="cv2", limit_s=_SILENT_S)


def count_frames(path: Path) -> tuple[int, int]:
    """How many frames of a video decode, and how many it says it has; errors as above."""
    *_, counted = stream_apart(str(path), _counts, Path(path), by="cv2", limit_s=_SILENT_S)
    return counted


def _frames(path: Path) -> Iterator[np.ndarray]:
    import cv2

    first, count = (), 0
    for frame in _decoded(path):
        count += 1
        _require_few(path, count)
        first = first or frame.shape
        if frame.shape != first:
            raise InputError(
                f"{path} has frames of {first[1]}x{first[0]} and {frame.shape[1]}x"
                f"{frame.shape[0]} px; all have to be of one size"
            )
        yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
    _require_two(path, count)


def _decoded(path: Path) -> Iterator[np.ndarray]:
    """Frames, BGR."""
    capture = _opened(path)
    if _is_av1(capture):
        yield from (frame.to_ndarray(format="bgr24") for frame in _av1(path))
        return
    while True:
        read, frame = capture.read()
        if not read:
            return
        yield frame


def _is_av1(capture: cv2.VideoCapture) -> bool:
    import cv2

    code = int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
    return code.to_bytes(4, "little").upper() == b"AV01"


def _av1(path: Path) -> Iterator[VideoFrame]:
    try:
        import av
        from av.error import FFmpegError
    except ImportError:
        raise InputError(
            f"{path} is coded in AV1, which needs PyAV: pip install 'taccel-lab[datasets]'"
        ) from None
    # Options as OpenCV gets them from the environment.
    options = dict(pair.split(";") for pair in ENVIRONMENT[CAPTURE_OPTIONS].split("|", 1))
    try:
        with av.open(str(path.absolute()), options=options) as container:
            yield from container.decode(video=0)
    except FFmpegError:
        return  # As OpenCV does: what was decoded so far counts.


def _counts(path: Path) -> Iterator[tuple[int, int]]:
    """The count so far now and then: to count a long video may take long."""
    import cv2

    capture, count = _opened(path), 0
    stated = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    stated = int(stated) if 0 < stated < 2**31 else 0
    # Each decodes, but makes no picture.
    decoded = _av1(path) if _is_av1(capture) else iter(capture.grab, False)
    for _ in decoded:
        count += 1
        _require_few(path, count)
        if count % _TOLD_FRAMES == 0:
            yield count, stated
    _require_two(path, count)
    yield count, stated


def _opened(path: Path) -> cv2.VideoCapture:
    import cv2

    cv2.setNumThreads(1)  # Each takes address space, which counts as memory.
    path = require_regular_file(path, LARGEST_BYTES, "a video")
    # FFmpeg takes some names for addresses, never those that begin with a slash.
    capture = cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG)
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    width, height = (
        capture.get(side) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
    )
    if width * height > MAX_FRAME_PIXELS:
        raise InputError(
            f"{path} has frames of {width:.0f} x {height:.0f} px; "
            f"{MAX_FRAME_PIXELS / 1e6:.0f} megapixels are allowed"
        )
    return capture


def _require_two(path: Path, count: int) -> None:
    if count < 2:
        raise InputError(
            f"{path} does not decode as a video ({count} frames read); {ALLOWED} is allowed, or "
            "give the frames as images"
        )


def _require_few(path: Path, count: int) -> None:
    if count > MAX_FRAMES:
        raise InputError(f"{path} has more than {MAX_FRAMES} frames, the most for a video")
