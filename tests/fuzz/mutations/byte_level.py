# SPDX-License-Identifier: Apache-2.0
"""Damage that knows nothing of a format."""

from __future__ import annotations

import struct

from tests.fuzz.mutations.draw import Draw, Surroundings
from tests.fuzz.mutations.values import DIGITS, NUMBERS

_WHOLE = (0, 1, 255, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 24, 100_000)
_REAL = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e38, 1e-38)


def flip(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """Some bits the other way round."""
    changed = bytearray(data)
    for _i in range(1 + draw.below(16)):
        if changed:
            changed[draw.below(len(changed))] ^= 1 << draw.below(8)
    return bytes(changed)


def delete(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """A run is missing."""
    begin, end = draw.span(len(data), max(4, len(data) // 8))
    return data[:begin] + data[end:]


def duplicate(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """A run stands twice."""
    begin, end = draw.span(len(data), max(4, len(data) // 4))
    return data[:end] + data[begin:end] + data[end:]


def truncate(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """Cut short."""
    return data[: draw.below(len(data) + 1)]


def insert(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """Foreign bytes in between."""
    at = draw.below(len(data) + 1)
    return data[:at] + draw.some_bytes(1 + draw.below(40)) + data[at:]


def insert_number(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """A number in words in between."""
    at = draw.below(len(data) + 1)
    return data[:at] + draw.pick((DIGITS, *NUMBERS)).encode() + data[at:]


def blank(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """A run of zeros, or of ones."""
    begin, end = draw.span(len(data), max(8, len(data) // 4))
    return data[:begin] + draw.pick((b"\0", b"\xff", b" ")) * (end - begin) + data[end:]


def splice(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """Begins as itself and goes on as another file."""
    other = draw.pick(around.others) if around.others else data[::-1]
    return data[: draw.below(len(data) + 1)] + other[draw.below(len(other) + 1) :]


def exchange(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """Another file's content."""
    foreign = (b"\x89PNG\r\n\x1a\n", b"%PDF-1.4", b"PK\x05\x06" + bytes(18), b"\x1f\x8b\x08", b"{")
    return draw.pick((*around.others, *foreign, b"\0" * 4096))


def empty(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """Nothing, or white space."""
    return draw.pick((b"", b"\n", b" ", b"\0", b"\xef\xbb\xbf"))


def whole_number(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """Four bytes as a count or an offset, mostly near the start, where headers are."""
    if len(data) < 8:
        return data + b"\xff" * 8
    place = draw.below(min(len(data), 512 if draw.chance(0.7) else len(data)) - 4) & ~1
    value = draw.pick(_WHOLE)
    form = draw.pick(("<I", ">I", "<H", ">H"))
    packed = struct.pack(form, value & (0xFFFF if form[1] == "H" else 0xFFFFFFFF))
    return data[:place] + packed + data[place + len(packed) :]


def real_number(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """Four or eight bytes as a float."""
    packed = struct.pack(draw.pick(("<f", "<d", ">f", ">d")), draw.pick(_REAL))
    place = draw.below(max(1, len(data) - len(packed))) & ~1
    return data[:place] + packed + data[place + len(packed) :]


def repeat(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """The whole content several times."""
    return data * (2 + draw.below(20))


MUTATORS = (
    flip, flip, delete, duplicate, truncate, truncate, insert, insert_number, blank, splice,
    exchange, empty, whole_number, whole_number, real_number, repeat,
)  # fmt: skip
