# SPDX-License-Identifier: Apache-2.0
"""Image files, decoded by OpenCV in the readers' process.

Pixels are as the file stores them, which is as the sensor gave them. A tag that asks a viewer to
turn the picture (EXIF, TIFF) is not followed: cameras write it by how they are held, so that it
differs between pictures whose pixels belong together.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import MAX_IMAGE_PIXELS, read_apart
from taccel_lab.files.declared import require_held
from taccel_lab.files.foreign_images import ALLOWED, foreign_format, format_words
from taccel_lab.files.regular_file import read_regular_file

MAX_FILE_BYTES = 512 << 20
"""The largest image that is allowed, of 16 bits and not compressed, fits in."""
_BEGINNINGS = (b"\x89PNG", b"\xff\xd8\xff", b"BM", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"RIFF")
_PNG_COLOR_TYPE = 25
"""Place of the colour type in a PNG's header."""
_PNG_WITH_ALPHA = (4, 6)
"""Colour types of grey and of RGB with alpha."""
_JPEG_FRAMES = tuple(bytes([kind]) for kind in range(0xC0, 0xC8) if kind != 0xC4)
"""Kinds of segments that state a size, of Huffman codes."""
_JPEG_PIXELS = 512
"""Pixels that a byte of a JPEG stands for at most."""
_TIFF_ORDER: dict[bytes, Literal["little", "big"]] = {b"II": "little", b"MM": "big"}
_TIFF_HEADER_BYTES = 16
_TIFF_ENTRIES = 0xFFFF
"""Most entries of a directory: what TIFF 6.0 has room to count. BigTIFF counts in 64 bits."""
_ORIENTATION, _SHORT = 274, 3
"""Number of TIFF's tag, and of the type of its value."""
LOW_16_BIT = 4096
"""Sixteen-bit images that stay below this hold 12 bits or fewer in the low places."""


def read_image(path: Path) -> np.ndarray:
    """An image file as RGB uint8, shape [height, width, 3], as it is stored.

    Raises InputError with the path when it is none of ``ALLOWED``, is damaged or cut short, has
    more than ``MAX_IMAGE_PIXELS``, or values of other than 8 or 16 bits.
    """
    return read_apart(str(path), _rgb, Path(path), by="cv2")


def read_grey(path: Path) -> np.ndarray:
    """An image file as grey levels, uint8, shape [height, width]; errors as above."""
    return read_apart(str(path), _grey, Path(path), by="cv2")


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of :func:`read_image` [px], and its errors: the image is decoded for it."""
    return read_apart(str(path), _size, Path(path), by="cv2")


Image = Path | np.ndarray | Callable[[], np.ndarray]
"""A file, RGB levels, or what reads them."""


def levels(image: Image | str) -> np.ndarray:
    """RGB levels of an image that is in memory already, in a file, or read on demand."""
    if callable(image):
        return image()
    return image if isinstance(image, np.ndarray) else read_image(Path(image))


def _rgb(path: Path) -> np.ndarray:
    import cv2

    image = _decoded_file(path, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if image.dtype == np.uint16:
        brightest = int(image.max())
        if 0 < brightest < LOW_16_BIT:
            raise InputError(
                f"{path} has 16 bits and no value above {brightest}: raw values of a camera of 12 "
                "bits or fewer, which would be black here. Save 8 bits, or values scaled to 65535"
            )
        image >>= 8
        image = image.astype(np.uint8)
    elif image.dtype != np.uint8:
        raise InputError(f"{path} holds {image.dtype} values; images of 8 or 16 bits are allowed")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _grey(path: Path) -> np.ndarray:
    import cv2

    return _decoded_file(path, cv2.IMREAD_GRAYSCALE)


def _size(path: Path) -> tuple[int, int]:
    height, width = _rgb(path).shape[:2]
    return width, height


def decoded_bgr(data: bytes, name: Path | str) -> np.ndarray:
    """Levels of an encoded image in OpenCV's order of channels, uint8, shape [height, width, 3].

    For code that runs in the readers' process. Raises InputError with ``name`` as ``read_image``.
    """
    import cv2

    return _decoded(data, name, cv2.IMREAD_COLOR)


def _decoded_file(path: Path, flags: int) -> np.ndarray:
    return _decoded(read_regular_file(path, MAX_FILE_BYTES, "an image"), path, flags)


def _decoded(data: bytes, path: Path | str, flags: int) -> np.ndarray:
    import cv2

    cv2.setNumThreads(1)  # Each takes address space, which counts as memory.
    if not data:
        raise InputError(f"{path} is empty (0 bytes); copy it again or leave it out")
    if (foreign := foreign_format(data)) is not None:
        raise InputError(f"{path} {format_words(foreign)}")
    _require_held(data, path)
    image = None
    if data.startswith(_BEGINNINGS):
        try:
            image = cv2.imdecode(
                np.frombuffer(_not_turned(data, path), dtype=np.uint8),
                flags | cv2.IMREAD_IGNORE_ORIENTATION,
            )
        except cv2.error as error:
            if error.code == cv2.Error.StsNoMem:
                raise MemoryError from None
    if image is None:
        raise InputError(f"{path} {_fault(data)}")
    if _is_invisible(data):
        raise InputError(
            f"{path} is fully transparent: no pixel of it shows. Save the camera's picture without "
            "an alpha channel"
        )
    return image


def _require_held(data: bytes, path: Path | str) -> None:
    """Refuse a JPEG too short for its size, whose pixels OpenCV would make up: one bit a block of
    64 is the least that a whole one has. Layout: ITU-T T.81, B.1."""
    at = 2
    while data.startswith(b"\xff\xd8") and data[at : at + 1] == b"\xff":
        kind, length = data[at + 1 : at + 2], int.from_bytes(data[at + 2 : at + 4], "big")
        if kind in _JPEG_FRAMES:
            height, width = (int.from_bytes(data[at + k : at + k + 2], "big") for k in (5, 7))
            require_held(path, "pixels", width * height, len(data), _JPEG_PIXELS)
            return
        at += 2 + max(length, 2)


def _not_turned(data: bytes, path: Path | str) -> bytes:
    """The file with the orientation 1 in a TIFF's first directory: OpenCV turns TIFF whatever its
    flags say. Layout: TIFF 6.0 (Adobe, 1992), section 2, and libtiff's BigTIFF."""
    order = _TIFF_ORDER.get(data[:2])
    if order is None or len(data) < _TIFF_HEADER_BYTES:
        return data
    big = data[2:4].strip(b"\0") == b"+"
    # Bytes of the directory's address, its count of entries, and an entry.
    address, counted, entry = (slice(8, 16), 8, 20) if big else (slice(4, 8), 2, 12)
    start = int.from_bytes(data[address], order)
    count = int.from_bytes(data[start : start + counted], order)
    first = start + counted
    if count > _TIFF_ENTRIES:
        raise InputError(f"{path} states {count:,} entries of a directory; it is damaged")
    for at in range(first, min(first + count * entry, len(data) - entry + 1), entry):
        if int.from_bytes(data[at : at + 2], order) == _ORIENTATION:
            stored = [_ORIENTATION.to_bytes(2, order), _SHORT.to_bytes(2, order)]
            stored += [(1).to_bytes(8 if big else 4, order), (1).to_bytes(2, order)]
            upright = b"".join(stored)
            return data[:at] + upright + data[at + len(upright) :]
    return data


def _is_invisible(data: bytes) -> bool:
    """Whether the image has an alpha channel in which no pixel shows.

    Only of PNG, whose header says whether there is one; the fourth byte of other formats is often
    left at 0 and means nothing.
    """
    import cv2

    if not data.startswith(b"\x89PNG") or data[_PNG_COLOR_TYPE] not in _PNG_WITH_ALPHA:
        return False
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    return image is not None and image.shape[2:] == (4,) and not image[..., 3].any()


def _fault(data: bytes) -> str:
    """Why OpenCV does not read an image, as far as its header tells."""
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None  # Only the header is read.
    try:
        with Image.open(io.BytesIO(data)) as header:
            (width, height), kind = header.size, header.format
    except Exception:  # Whatever a damaged header makes of it, it is no image to Pillow either.
        width, height, kind = 0, 0, None
    if width * height > MAX_IMAGE_PIXELS:
        return (
            f"is an image of {width} x {height} px according to its header; "
            f"{MAX_IMAGE_PIXELS / 1e6:.0f} megapixels are allowed"
        )
    if kind is not None and not data.startswith(_BEGINNINGS):
        return f"is an image of the format {kind}; {ALLOWED} is allowed"
    return (
        f"is not an image that can be read, or is damaged or cut short; {ALLOWED} is allowed. Copy "
        "it again or leave it out"
    )


KEPT_BYTES = 512 << 20
"""Most bytes of levels that are held: 2,300 images of 320x240 px, 580 of 640x480 px."""


class KeptImages:
    """Images by path, read when they are first asked for and held while there is room.

    Images beyond ``limit_bytes`` are decoded each time: those that came first stay, since steps
    that go through all images in one order would find nothing of the latest ones.
    """

    def __init__(self, limit_bytes: int = KEPT_BYTES) -> None:
        self._room = limit_bytes
        self._kept: dict[Path, np.ndarray] = {}

    def read(self, path: Path) -> np.ndarray:
        """RGB uint8 of shape [height, width, 3], read-only; errors as of ``read_image``."""
        image = self._kept.get(path)
        if image is None:
            image = read_image(path)
            image.flags.writeable = False
            if image.nbytes <= self._room:
                self._room -= image.nbytes
                self._kept[path] = image
        return image
