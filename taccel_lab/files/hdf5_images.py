# SPDX-License-Identifier: Apache-2.0
"""Images of cameras in an HDF5 file, read by h5py in the readers' process.

Two forms are images: levels, uint8, shape [frame, height, width, 3], RGB; and in UniVTAC's files
(univtac/UniVTAC, ``envs/utils/data.py``) streams of JPEG or PNG whose name holds ``rgb``. Its
writer hands RGB to OpenCV's encoder, which takes it for BGR: colours are as OpenCV decodes them.
Encoded images of other files are left out, since nothing says which order theirs are in.

What an HDF5 file names elsewhere (links to other files, external and virtual data) is not read.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import read_apart, stream_apart
from taccel_lab.files.images import decoded_bgr
from taccel_lab.files.recorded_frame import RecordedFrame
from taccel_lab.files.regular_file import LARGEST_BYTES, require_regular_file
from taccel_lab.files.videos import MAX_FRAME_PIXELS, MAX_FRAMES

if TYPE_CHECKING:
    import h5py

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""HDF5 File Format Specification 3.0, II.A."""
UNIVTAC = "tactile"
"""Group at the top of UniVTAC's files."""
MAX_DEPTH, MAX_OBJECTS = 8, 10_000
"""Groups in groups, and objects."""


def is_hdf5(path: Path) -> bool:
    """Whether a file is there that begins as HDF5 does."""
    try:
        return path.is_file() and path.open("rb").read(len(SIGNATURE)) == SIGNATURE
    except OSError:  # What stands in the way, its reader says.
        return False


def hdf5_cameras(path: Path) -> dict[str, int]:
    """How many frames there are by name of the data set, such as ``tactile/left_tactile/rgb``.

    Raises InputError without h5py, and for a file that it cannot read.
    """
    return read_apart(str(path), _cameras, Path(path), by="h5py")


def hdf5_frames(path: Path, name: str) -> Iterator[RecordedFrame]:
    """Frames of one of :func:`hdf5_cameras`; the files say no times."""
    images = stream_apart(str(path), _frames, Path(path), name, by="h5py")
    for number, image in enumerate(images):
        yield RecordedFrame(f"{number}", image)


def _cameras(path: Path) -> dict[str, int]:
    with _opened(path) as file:
        return {name: min(len(data), MAX_FRAMES) for name, data in _images(file)}


def _frames(path: Path, name: str) -> Iterator[np.ndarray | InputError]:
    with _opened(path) as file:
        data = dict(_images(file))[name]
        for number in range(min(len(data), MAX_FRAMES)):
            try:
                row = data[number]
            except OSError as error:  # A damaged or unknown filter.
                yield InputError(f"{path}: {name} {number} cannot be read: {error}")
                continue
            if data.ndim == 4:
                yield row
                continue
            content = row if isinstance(row, bytes) else np.asarray(row, np.uint8).tobytes()
            try:
                yield decoded_bgr(content, f"{path}: {name} {number}")
            except InputError as error:
                yield error


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """The file; what h5py raises of a damaged one, whatever its class, becomes a sentence."""
    try:
        import h5py
    except ImportError:
        raise InputError(
            f"{path} is read by h5py, which is not installed: pip install 'taccel-lab[datasets]'"
        ) from None
    path = require_regular_file(path, LARGEST_BYTES, "an HDF5 file")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except InputError:
        raise
    except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise InputError(f"{path} is no HDF5 file that can be read: {error}") from None


def _images(
    group: h5py.Group, prefix: str = "", seen: set[Any] | None = None, depth: int = 0
) -> Iterator[tuple[str, h5py.Dataset]]:
    """Those below a group, each once: links may go in circles."""
    import h5py

    seen = set() if seen is None else seen
    for name in sorted(group):
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item, path = group[name], f"{prefix}{name}"
        if item in seen:
            continue
        seen.add(item)
        if len(seen) > MAX_OBJECTS:
            raise InputError(f"{group.file.filename} holds more than {MAX_OBJECTS:,} objects")
        if isinstance(item, h5py.Group):
            if depth < MAX_DEPTH:
                yield from _images(item, f"{path}/", seen, depth + 1)
        elif isinstance(item, h5py.Dataset) and _is_images(item, name):
            yield path, item


def _is_images(data: h5py.Dataset, name: str) -> bool:
    import h5py

    if data.external or data.is_virtual or not data.shape or not data.shape[0]:
        return False
    if data.ndim == 4:
        pixels = data.shape[1] * data.shape[2]
        return data.dtype == np.uint8 and data.shape[3] == 3 and pixels <= MAX_FRAME_PIXELS
    encoded = data.dtype.kind == "S" or h5py.check_vlen_dtype(data.dtype) == np.uint8
    return data.ndim == 1 and encoded and "rgb" in name and UNIVTAC in data.file
