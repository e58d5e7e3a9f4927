# SPDX-License-Identifier: Apache-2.0
"""Counts and sizes that a file states, made larger: the number of its frames, points or bytes."""

from __future__ import annotations

import re
import struct

from tests.fuzz.mutations.draw import Draw, Surroundings

_LARGE = (
    1000, 1 << 16, 1 << 20, 10**9, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 34, 1 << 40, 1 << 60, (1 << 64) - 1,
)  # fmt: skip
_WORD = re.compile(rb"(?<![\w.+-])\d{1,7}(?![\w.])")
"""A whole number in words."""
_TRIED = 400
"""Places that are looked at for a whole number in bytes."""
_MOST = 1 << 20
"""Larger numbers are mostly none."""


def larger_word(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """One or all of the whole numbers in words of one value; in bytes where there are none."""
    # Words of an image or of packed bytes are none of its header.
    words = list(_WORD.finditer(data, 0, 1 << 16))
    if not words:
        return larger_number(data, draw, around)
    word = draw.pick(words)
    new = str(draw.pick(_LARGE)).encode()
    if draw.chance(0.3):
        return re.sub(rb"(?<![\w.+-])" + word[0] + rb"(?![\w.])", new, data)
    return data[: word.start()] + new + data[word.end() :]


def larger_number(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """A whole number in bytes, of four or eight, little or big end first."""
    form = draw.pick(("<I", ">I", "<Q", "<Q"))
    width = struct.calcsize(form)
    for _ in range(_TRIED):
        at = draw.below(max(1, len(data) - width))
        piece = data[at : at + width]
        if len(piece) == width and 1 < struct.unpack(form, piece)[0] < _MOST:
            value = draw.pick(_LARGE) & ((1 << 8 * width) - 1)
            return data[:at] + struct.pack(form, value) + data[at + width :]
    return data + b"\xff" * width


MUTATORS = (larger_word, larger_number, larger_number)
