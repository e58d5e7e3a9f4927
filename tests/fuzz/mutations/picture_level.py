# SPDX-License-Identifier: Apache-2.0
"""Damage to images and videos: claimed sizes, chunks, and pictures of other kinds."""

from __future__ import annotations

import struct
import zlib
from functools import cache

import cv2
import numpy as np

from tests.fuzz.mutations import byte_level
from tests.fuzz.mutations.draw import Draw, Surroundings

_SIZES = (0, 1, 2, 31, 33, 64, 1000, 20_000, 65_535, 100_000, 1 << 24, 0x7FFFFFFF, 0xFFFFFFFF)
_KINDS = (
    "grey.png", "deep.png", "raw12.png", "alpha.png", "tiny.png", "wide.png", "black.png",
    "white.png", "color.jpg", "grey.jpg", "color.bmp", "color.tiff", "float.tiff", "color.webp",
    "float.hdr", "color.ppm", "noise.png", "pixel.png", "float.exr",
)  # fmt: skip


@cache
def _picture(kind: str) -> bytes:
    name, suffix = kind.split(".")
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (36, 48, 3), dtype=np.uint8)
    shapes = {"tiny": (5, 5, 3), "pixel": (1, 1, 3), "wide": (36, 49, 3), "alpha": (36, 48, 4)}
    if name in shapes:
        image = rng.integers(0, 256, shapes[name], dtype=np.uint8)
    elif name == "grey":
        image = image[..., 0]
    elif name == "deep":
        image = image.astype(np.uint16) * 257
    elif name == "raw12":
        image = image.astype(np.uint16) * 16
    elif name in ("black", "white"):
        image = np.full_like(image, 0 if name == "black" else 255)
    elif name == "float":
        image = image.astype(np.float32)
        image[0, 0] = np.nan
    try:
        done, data = cv2.imencode(f".{suffix}", np.ascontiguousarray(image))
    except cv2.error:
        return b"not in this build"
    return data.tobytes() if done else b""


def other_picture(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """A sound picture of another kind or size under the same name."""
    return _picture(draw.pick(_KINDS))


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    found, at = [], 8
    while at + 12 <= len(data):
        size = struct.unpack(">I", data[at : at + 4])[0]
        found.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    return found


def _png(chunks: list[tuple[bytes, bytes]]) -> bytes:
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, content in chunks:
        check = struct.pack(">I", zlib.crc32(kind + content))
        parts.append(struct.pack(">I", len(content)) + kind + content + check)
    return b"".join(parts)


def png_chunks(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """A PNG with another header, or a chunk missing, twice, or more than it says."""
    chunks = _chunks(data) if data.startswith(b"\x89PNG") else []
    if not chunks or len(chunks[0][1]) < 13:
        return byte_level.whole_number(data, draw, around)
    head, way = bytearray(chunks[0][1]), draw.below(6)
    if way == 0:
        head[0:4] = struct.pack(">I", draw.pick(_SIZES))
    elif way == 1:
        head[4:8] = struct.pack(">I", draw.pick(_SIZES))
    elif way == 2:
        head[8 + draw.below(5)] = draw.pick((0, 1, 2, 3, 4, 6, 16, 255))
    elif way == 3:
        del chunks[draw.below(len(chunks))]
        return _png(chunks)
    elif way == 4:
        at = draw.below(len(chunks))
        chunks.insert(at, chunks[at])
        return _png(chunks)
    else:
        text = zlib.compress(bytes(8 << 20))
        extra = (
            (b"tEXt", b"a\0" + b"b" * 100_000), (b"zTXt", b"a\0\0" + text),
            (b"iCCP", b"p\0\0" + text),
            (b"eXIf", b"MM\0*\0\0\0\x08\xff\xff"), (b"PLTE", b"\0" * 768), (b"tRNS", b"\0" * 6),
            (b"gAMA", b"\0" * 4), (b"IDAT", text), (b"acTL", b"\xff" * 8),
        )  # fmt: skip
        chunks.insert(1 + draw.below(len(chunks)), draw.pick(extra))
        return _png(chunks)
    return _png([(b"IHDR", bytes(head)), *chunks[1:]])


def jpeg_segments(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """A JPEG that claims another size, or one turned by a tag."""
    place = max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2"))
    if place < 0:
        return byte_level.whole_number(data, draw, around)
    if draw.chance(0.3):
        turn = struct.pack(">HHHII", 1, 0x0112, 3, 1, draw.pick((0, 3, 6, 8, 99)) << 16)
        exif = b"Exif\0\0MM\0*\0\0\0\x08" + turn + bytes(4)
        return data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]
    at = place + 5 + 2 * draw.below(2)
    return data[:at] + struct.pack(">H", draw.pick(_SIZES) & 0xFFFF) + data[at + 2 :]


def video_header(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """Another size, count, rate or codec in the lists at the start of an AVI."""
    marks = {b"avih": (0, 4, 16, 20, 32, 36), b"strh": (0, 4, 20, 24, 28, 32, 36), b"strf":
             (0, 4, 8, 12, 14, 16), b"LIST": (-4,), b"RIFF": (-4,), b"00dc": (-4,)}  # fmt: skip
    mark = draw.pick(sorted(marks))
    place = data.find(mark)
    if place < 0:
        return byte_level.whole_number(data, draw, around)
    at = place + 8 + draw.pick(marks[mark])
    value = draw.pick((*_SIZES, 0x34363248, 0x20676E70))
    return data[:at] + struct.pack("<I", value) + data[at + 4 :]


def other_video(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """What is no video but is taken for one: a picture, or a list that names other files."""
    outside = str(around.outside)
    lists = (
        f"ffconcat version 1.0\nfile '{outside}'\n",
        f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile://{outside}\n#EXT-X-ENDLIST\n",
        f"<?xml version='1.0'?><MPD><BaseURL>file://{outside}</BaseURL></MPD>",
        f"[InternetShortcut]\nURL=file://{outside}\n",
    )
    return draw.pick((*(text.encode() for text in lists), _picture("color.jpg"), b"GIF89a" * 20))


MUTATORS = {
    ".png": (other_picture, other_picture, png_chunks, png_chunks),
    ".jpg": (other_picture, jpeg_segments, jpeg_segments),
    ".avi": (video_header, video_header, video_header, other_video),
}
