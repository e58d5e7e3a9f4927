# SPDX-License-Identifier: Apache-2.0
"""Pictures and videos of phones and cameras that are no image to any reader here, by their content.

Layouts: ISO 14496-12 (``ftyp``), ISO 23008-12 (HEIF), ISO 18181-2 (JPEG XL), TIFF 6.0, DNG 1.7.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

ALLOWED = "PNG, JPEG, BMP, TIFF or WebP"
WAY_OUT = "Save PNG, best with the sensor's own app: phones turn and process their pictures"
_HEAD_BYTES = 1 << 16
"""Bytes of a file that tell what it is."""
_MOST_FILES = 1000
"""Files of a folder that are looked at."""
_BRANDS = (
    ("AVIF", ("avif", "avis")),
    ("HEIC", ("heic", "heix", "heim", "heis", "hevc", "hevx", "hevm", "hevs", "mif1", "msf1")),
    ("camera RAW", ("crx ",)),
)
"""Formats by the brands of which a file states one; any other is a video's."""
_STARTS = (
    (b"\xff\x0a", "JPEG XL"),
    (b"\0\0\0\x0cJXL \r\n\x87\n", "JPEG XL"),
    (b"FUJIFILMCCD-RAW", "camera RAW"),
    (b"IIRO", "camera RAW"),
    (b"IIRS", "camera RAW"),
    (b"MMOR", "camera RAW"),
    (b"IIU\0", "camera RAW"),
    (b"\x1a\x45\xdf\xa3", "video"),
)
_ORDER: dict[bytes, Literal["little", "big"]] = {b"II*\0": "little", b"MM\0*": "big"}
_DNG_VERSION, _SUBFILE, _REDUCED = 50706, 254, 1
"""TIFF's tags, and the value of the second for a preview: the first of a RAW file."""


def foreign_format(data: bytes) -> str | None:
    """Format of a file that begins so, ``video`` for one that is a video; None for any that readers
    take or do not know."""
    for start, name in _STARTS:
        if data.startswith(start):
            return name
    if data[4:8] == b"ftyp":
        length = min(max(int.from_bytes(data[:4], "big"), 16), 256)
        brands = {data[at : at + 4].decode("latin-1") for at in (8, *range(16, length, 4))}
        return next((name for name, own in _BRANDS if brands & set(own)), "video")
    if data.startswith(b"RIFF") and data[8:12] == b"AVI ":
        return "video"
    return "camera RAW" if _is_raw(data) else None


def _is_raw(data: bytes) -> bool:
    """Whether a TIFF is a camera's raw file, of whose images the first is a preview."""
    order = _ORDER.get(data[:4])
    if order is None:
        return False
    if data[8:10] == b"CR":
        return True
    start = int.from_bytes(data[4:8], order)
    count = int.from_bytes(data[start : start + 2], order)
    entries = (data[at : at + 12] for at in range(start + 2, start + 2 + 12 * count, 12))
    tags = {int.from_bytes(e[:2], order): int.from_bytes(e[8:], order) for e in entries if e[11:]}
    return _DNG_VERSION in tags or tags.get(_SUBFILE) == _REDUCED


def unread_format(path: Path) -> str | None:
    """Format of a picture that no reader takes, by its content; None for any other file."""
    try:
        if not path.is_file():
            return None
        with path.open("rb") as stream:
            found = foreign_format(stream.read(_HEAD_BYTES))
    except OSError:
        return None
    return None if found == "video" else found


def format_words(name: str) -> str:
    """What a picture of a foreign format is, and what is allowed."""
    if name == "video":
        return f"is a video, no image; {ALLOWED} is allowed"
    return f"is an image of the format {name}; {ALLOWED} is allowed. {WAY_OUT}"


def unread_pictures(files: Iterable[Path]) -> str:
    """Sentence on those of some files that are pictures of a format that is not read, with a blank
    before it; empty where none is."""
    found = [
        (path, name)
        for path, _ in zip(files, range(_MOST_FILES), strict=False)
        if (name := unread_format(path)) is not None
    ]
    if not found:
        return ""
    kinds = Counter(name for _, name in found)
    words = " and ".join(f"{count} of the format {name}" for name, count in kinds.items())
    return f". It holds {words} ({found[0][0].name}), which is not read. {WAY_OUT}"
