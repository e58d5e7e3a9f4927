# SPDX-License-Identifier: Apache-2.0
"""Arrays, pictures and texts that state, or unpack to, more than they hold."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path

import cv2
import numpy as np

from tests.files.bombs.written import Make, written


def packed_zeros(folder: Path) -> Path:
    """700 MiB of zeros in 0.7 MB."""
    path = folder / "a.npz"
    head = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({700 << 20},), }}".ljust(117)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file, file.open("a.npy", "w") as npy:
        npy.write(b"\x93NUMPY\1\0" + struct.pack("<H", 118) + head.encode() + b"\n")
        for _ in range(700):
            npy.write(bytes(1 << 20))
    return path


def png(width: int, height: int, rows: int) -> Make:
    """A PNG of a size with the data of some rows."""
    data = b"\x89PNG\r\n\x1a\n"
    for kind, content in (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(bytes((3 * width + 1) * rows), 9)),
        (b"IEND", b""),
    ):
        check = struct.pack(">I", zlib.crc32(kind + content))
        data += struct.pack(">I", len(content)) + kind + content + check
    return written("a.png", data)


def jpeg(width: int, height: int) -> Make:
    """A progressive JPEG of a few hundred bytes that states a size."""
    still = np.full((16, 16, 3), 90, np.uint8)
    data = cv2.imencode(".jpg", still, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    at = data.index(b"\xff\xc2") + 5
    return written("a.jpg", data[:at], struct.pack(">HH", height, width), data[at + 4 :])


def tiff(folder: Path) -> Path:
    """A BigTIFF whose directory has 2^60 entries, in a file of holes."""
    path = folder / "a.tiff"
    path.write_bytes(b"II+\0\x08\0\0\0" + struct.pack("<QQ", 16, 1 << 60))
    with path.open("r+b") as file:
        file.truncate(400 << 20)
    return path


def zarr_shape(folder: Path) -> Path:
    """An array of 16 million pictures of which none is written."""
    import zarr

    group = zarr.create_group(folder / "data.zarr", zarr_format=3)
    group.create_array("rgb", shape=(1 << 24, 2048, 2048, 3), chunks=(1, 512, 512, 3), dtype="u1")
    return folder / "data.zarr"


def repeated(name: str, head: str, piece: str, count: int, end: str = "") -> Make:
    """A text of one piece over and over, made when it is written."""
    return lambda folder: written(name, head, piece * count, end)(folder)
