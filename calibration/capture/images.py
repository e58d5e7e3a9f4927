# SPDX-License-Identifier: Apache-2.0
"""Image files and their hashes."""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np

from taccel_lab.errors import InputError


def read_image(path: Path) -> np.ndarray:
    """Read an image file as RGB uint8, shape [height, width, 3]."""
    image = decode(path, cv2.IMREAD_COLOR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def decode(path: Path, flags: int) -> np.ndarray:
    if not path.is_file():
        raise InputError(f"{path} does not exist; the manifest names it")
    # Decoding from memory keeps OpenCV from printing its own warning for a broken file.
    data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(data, flags) if data.size else None
    if image is None:
        raise InputError(f"{path} is not an image that can be read; PNG or JPEG is allowed")
    return image


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image file [px]."""
    height, width = decode(path, cv2.IMREAD_UNCHANGED).shape[:2]
    return width, height


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
