# SPDX-License-Identifier: Apache-2.0
"""Text that any terminal and file takes, and a person can read, whatever a damaged file holds."""

from __future__ import annotations

import re

WORD_CHARACTERS = 400
"""Longer words are damage; paths are shorter."""
ERROR_CHARACTERS = 1000
"""Most characters of what a library says; some repeat the whole file."""
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
_LONG_WORD = re.compile(rf"\S{{{WORD_CHARACTERS + 1},}}")


def printable(text: object) -> str:
    r"""``text`` with escapes for what cannot be encoded, and for control characters.

    File names may hold any bytes; Python keeps those that are not UTF-8 as lone surrogates, which
    no file or terminal takes: ``\udcff`` stands for the byte 0xff.
    """
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), str(text))


def printable_lines(text: str) -> str:
    """Lines, each printable."""
    return "\n".join(map(printable, text.split("\n")))


def words_of(error: BaseException) -> str:
    """What an error of a library says, in one line, or its type where it says nothing: text of C++
    in it need not be UTF-8, and then ``str`` of the error fails itself."""
    try:
        words = " ".join(str(error).split())
    except Exception:
        return f"{type(error).__name__}, whose own words are no text"
    return words[:ERROR_CHARACTERS] or type(error).__name__


def readable(message: str) -> str:
    """A message of several lines, each printable, its endless words cut in the middle."""
    return _LONG_WORD.sub(_cut, printable_lines(message))


def _cut(found: re.Match[str]) -> str:
    word = found[0]
    return f"{word[:60]}...({len(word):,} letters)...{word[-20:]}"


def counted(count: int, one: str, many: str | None = None) -> str:
    """``1 view`` or ``3 views``; ``many`` where the plural is not ``one`` with an s."""
    return f"{count} {one if count == 1 else many or one + 's'}"
