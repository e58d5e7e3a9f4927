# SPDX-License-Identifier: Apache-2.0
"""Image files and their hashes."""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np

from taccel_lab.errors import InputError

LOW_16_BIT = 4096
"""Sixteen-bit images that stay below this hold 12 bits or fewer in the low places."""


def read_image(path: Path) -> np.ndarray:
    """Read an image file as RGB uint8, shape [height, width, 3]."""
    image = decode(path, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if image.dtype == np.uint16:
        image = _eight_bits(image, path)
    elif image.dtype != np.uint8:
        raise InputError(f"{path} holds {image.dtype} values; images of 8 or 16 bits are allowed")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def levels(image: Path | np.ndarray | str) -> np.ndarray:
    """RGB levels of an image that is in memory already, or in a file."""
    return image if isinstance(image, np.ndarray) else read_image(Path(image))


def _eight_bits(image: np.ndarray, path: Path) -> np.ndarray:
    brightest = int(image.max())
    if 0 < brightest < LOW_16_BIT:
        raise InputError(
            f"{path} has 16 bits and no value above {brightest}: raw values of a camera of 12 bits "
            "or fewer, which would be black here. Save 8 bits, or values scaled to 65535"
        )
    return (image >> 8).astype(np.uint8)


def decode(path: Path, flags: int) -> np.ndarray:
    """An image file as OpenCV's ``flags`` say, any depth; InputError when it cannot be read."""
    if not path.is_file():
        raise InputError(f"{path} does not exist; the manifest names it")
    # Decoding from memory keeps OpenCV from printing its own warning for a broken file.
    data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    if not data.size:
        raise InputError(f"{path} is empty (0 bytes); copy it again or leave it out")
    image = cv2.imdecode(data, flags)
    if image is None:
        raise InputError(
            f"{path} is not an image that can be read, or is cut short; PNG or JPEG is allowed. "
            "Copy it again or leave it out"
        )
    return image


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image file [px], turned as its EXIF tag says, like ``read_image``."""
    height, width = decode(path, cv2.IMREAD_GRAYSCALE).shape[:2]
    return width, height


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
