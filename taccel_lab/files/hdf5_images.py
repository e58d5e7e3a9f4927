# SPDX-License-Identifier: Apache-2.0
"""Images of cameras in an HDF5 file, read by h5py in the readers' process.

Two forms are images: levels, uint8, shape [frame, height, width, 3], RGB; and in UniVTAC's files
(univtac/UniVTAC, ``envs/utils/data.py``) streams of JPEG or PNG whose name holds ``rgb``. Its
writer hands RGB to OpenCV's encoder, which takes it for BGR: colours are as OpenCV decodes them.
Encoded images of other files are left out, since nothing says which order theirs are in.

What an HDF5 file names elsewhere (links to other files, external and virtual data) is not read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import read_apart, stream_apart
from taccel_lab.files.declared import PACKED_TIMES, require_few, require_held
from taccel_lab.files.images import decoded_bgr
from taccel_lab.files.regular_file import LARGEST_BYTES, in_bytes, require_regular_file
from taccel_lab.files.videos import MAX_FRAME_PIXELS, MAX_FRAMES, RecordedFrame
from taccel_lab.processes.child_process import no_more_memory

if TYPE_CHECKING:
    import h5py

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""HDF5 File Format Specification 3.0, II.A."""
UNIVTAC = "tactile"
"""Group at the top of UniVTAC's files."""
MAX_DEPTH, MAX_OBJECTS = 8, 10_000
"""Groups in groups, and objects."""
BLOCK_BYTES = 384 << 20
"""Most bytes that are unpacked at a time: those of all frames that a packed chunk goes over."""
SPARE_BYTES = 512 << 20
"""Most memory that h5py may take to read some frames, besides the size of the file."""
CACHE_BYTES = 64 << 20
"""Most bytes of unpacked chunks that h5py keeps: those of a thousand streams each take 16 KiB."""


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
        return {name: len(data) for name, data in _images(file)}


def _frames(path: Path, name: str) -> Iterator[np.ndarray | InputError]:
    with _opened(path) as file:
        data, size, read = dict(_images(file))[name], path.stat().st_size, 0
        block = _block(path, data, size)
        for first in range(0, len(data), block):
            last = min(first + block, len(data))
            try:
                with no_more_memory(size + SPARE_BYTES):  # A stream may state any length.
                    rows = data[first:last]
            except (
                OSError,
                MemoryError,
            ) as error:  # A damaged or unknown filter: all of the block need it.
                for number in range(first, last):
                    yield InputError(f"{path}: {name} {number} cannot be read: {error}")
                continue
            for number, row in enumerate(rows, first):
                if data.ndim == 4:
                    yield row
                    continue
                content = row if isinstance(row, bytes) else np.asarray(row, np.uint8).tobytes()
                read += len(content)
                if data.dtype.kind == "O":  # They lie in the file as they are, each for itself.
                    require_held(path, f"frames {name}", read, size, 1)
                try:
                    yield decoded_bgr(content, f"{path}: {name} {number}")
                except InputError as error:
                    yield error


def _block(path: Path, data: h5py.Dataset, size: int) -> int:
    """Frames that are read together, so that their chunks are unpacked once.

    Raises InputError for too many frames, more than a file of ``size`` bytes holds, and chunks that
    are too large.
    """
    what = f"frames {data.name}"
    require_few(path, what, len(data), MAX_FRAMES)
    frame = data.dtype.itemsize * math.prod(data.shape[1:])
    held = min(data.id.get_storage_size(), size)
    require_held(path, what, len(data) * frame, held, PACKED_TIMES if data.chunks else 1)
    if not (data.chunks and data.id.get_create_plist().get_nfilters()):
        return 1
    streams = data.dtype.kind == "O"
    chunk = data.id.get_type().get_size() * math.prod(data.chunks)
    unpacked, limit = chunk, CACHE_BYTES
    if not streams:  # All chunks beside one another are needed for one frame.
        unpacked, limit = max(chunk, data.chunks[0] * frame), BLOCK_BYTES
    if unpacked > limit:
        raise InputError(
            f"{path}: chunks of {data.chunks[0]:,} {what} unpack to {in_bytes(unpacked)} at a "
            f"time; {in_bytes(limit)} is allowed: write chunks of fewer frames"
        )
    return 1 if streams else data.chunks[0]


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
        with h5py.File(path, "r", rdcc_nbytes=CACHE_BYTES) as file:
            yield file
    except InputError:
        raise
    except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise InputError(f"{path} is no HDF5 file that can be read: {error}") from None


def _images(
    group: h5py.Group, prefix: str = "", seen: set[Any] | None = None, depth: int = 0
) -> Iterator[tuple[str, h5py.Dataset]]:
    """Images below a group, each once: links may go in circles."""
    import h5py

    seen = set() if seen is None else seen
    for name in sorted(group):
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item, path = group[name], f"{prefix}{name}"
        if item in seen:
            continue
        seen.add(item)
        require_few(group.file.filename, "objects", len(seen), MAX_OBJECTS)
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
