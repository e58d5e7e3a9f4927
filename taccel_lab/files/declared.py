# SPDX-License-Identifier: Apache-2.0
"""What a file states beside what it holds, compared before anything is unpacked, copied or waited
for: a few kilobytes may state, or name over and over, more than any machine has."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import in_bytes
from taccel_lab.printable import printable

PACKED_TIMES = 1100
"""Largest ratio of unpacked to packed bytes: deflate's most is 1,032 (zlib, "Technical
Details"); beyond it, they are packed twice or are not there."""


def require_few(path: Path | str, what: str, count: int, limit: int, advice: str = "") -> None:
    """Refuse more of what a file has than is read.

    Args:
        path: The file, to begin a sentence with.
        what: What is counted, in the plural: "rows".
        count: How many there are.
        limit: How many may be.
        advice: What to do.

    Raises InputError that says both.
    """
    if count > limit:
        advice = f": {advice}" if advice else ""
        raise InputError(f"{path} has {count:,} {what}; up to {limit:,} are allowed{advice}")


def require_held(
    path: Path | str, what: str, stated: int, held: int, times: float = PACKED_TIMES
) -> None:
    """Refuse what a file cannot hold.

    Args:
        path: The file, to begin a sentence with.
        what: What is stated, in the plural: "frames".
        stated: Its size [bytes].
        held: What the file has of it [bytes], packed or not.
        times: How often ``held`` may go into ``stated``.

    Raises InputError that says both.
    """
    if stated > times * held:
        raise InputError(
            f"{path} states {in_bytes(stated)} of {what}, but holds {in_bytes(held)}"
            + (f", {times:,.0f} times of which are allowed" if times > 1 and held else "")
            + ": it was not written whole, or is damaged"
        )


def require_few_copies(
    path: Path | str,
    parts: Mapping[Hashable, Sequence[Hashable]],
    roots: Iterable[Hashable],
    limit: int,
    *,
    own: Mapping[Hashable, int] | None = None,
    what: str = "parts",
) -> None:
    """Refuse parts of parts that stand for a great many, as 30 doublings do for a thousand million.

    Args:
        path: The file, to begin a sentence with.
        parts: What each part is made of, by name, as often as it stands there.
        roots: What the file shows.
        limit: What may be shown, each part counted as often as it is.
        own: What a part counts by itself; one where nothing is said.
        what: What is counted, in the plural.

    Raises InputError for more, and for a part that is made of itself.
    """
    counts: dict[Hashable, int] = {}
    above: set[Hashable] = set()
    total = 0
    for root in roots:
        waiting = [root]
        while waiting:
            name = waiting[-1]
            if name in counts:
                waiting.pop()
                continue
            inner = parts.get(name, ())
            left = [part for part in inner if part not in counts]
            if name in above or not left:
                waiting.pop()
                above.discard(name)
                # Where one is left, it is above itself.
                shown = limit if left else sum(counts[part] for part in inner)
                counts[name] = min((own or {}).get(name, 1) + shown, limit + 1)
            else:
                above.add(name)
                waiting += left
        total += counts[root]
    if total > limit:
        raise InputError(
            f"{path} shows more than {limit:,} {what}, each counted as often as it is shown; save "
            "what is needed alone"
        )


MAX_DIRECTORY_BYTES = 4 << 20
"""Most bytes of a zip's list of contents, which is read whole: some 50,000 names."""
_FAR_END = b"PK\x06\x07"
"""Begins the place of ZIP64's own end (APPNOTE 6.3.10, 4.3.15)."""
PLENTY_BYTES, _ZIP_TIMES = 64 << 20, 200
"""What any archive may unpack to, and beyond it, how many times its own size: arrays in which a
tenth of the numbers differ pack to less than a fiftieth."""


def require_small_directory(file: IO[bytes]) -> None:
    """Refuse a zip whose list of contents takes much memory; errors go on a sentence with "it"."""
    # Its end: 22 bytes and a comment. Where a place of 20 bytes stands before it, as archives of
    # more than 4 GiB need and others may have, the sizes that count are in the record there.
    size = file.seek(0, io.SEEK_END)
    file.seek(max(0, size - 22 - 0xFFFF))
    tail = file.read()
    end = tail.rfind(b"PK\x05\x06")
    if end < 0 or len(tail) - end < 22:
        single = tail.startswith(b"\x93NUMPY") and size <= len(tail)
        raise InputError("it is a single array (.npy)" if single else "it is no zip archive")
    (listed,) = struct.unpack_from("<I", tail, end + 12)
    if end >= 20 and tail.startswith(_FAR_END, end - 20):
        file.seek(min(struct.unpack_from("<Q", tail, end - 12)[0], size))
        # Cut short, or of no such record, it is larger than any.
        far = file.read(48).rjust(48, b"\xff")
        (listed,) = struct.unpack_from("<Q", far, 40)
    if listed > MAX_DIRECTORY_BYTES:
        raise InputError(
            f"its list of contents takes {in_bytes(listed)}; {in_bytes(MAX_DIRECTORY_BYTES)} is "
            "allowed"
        )
    file.seek(0)


def require_small(members: Iterable[zipfile.ZipInfo], limit: int, what: str) -> None:
    """Refuse members that unpack to more than ``limit`` bytes of ``what``, or to far more than the
    archive has of them; errors go on a sentence with the archive's name."""
    members = list(members)
    total = sum(member.file_size for member in members)
    packed = sum(member.compress_size for member in members)
    if total > limit:
        raise InputError(f"unpacks to {in_bytes(total)}; {in_bytes(limit)} of {what} are allowed")
    if total > max(PLENTY_BYTES, _ZIP_TIMES * packed):
        raise InputError(
            f"unpacks to {in_bytes(total)}, but holds {in_bytes(packed)}; {_ZIP_TIMES} times of "
            "which are allowed"
        )


def read_members(archive: zipfile.ZipFile) -> Iterator[tuple[str, bytes]]:
    """Names and contents of members of ``require_small``, for readers that believe any size.

    Raises InputError for one that unpacks to another size than it states, or is damaged; errors go
    on a sentence with the archive's name.
    """
    for member in archive.infolist():
        try:
            with archive.open(member) as stream:
                content = stream.read(member.file_size + 1)
        except Exception as error:  # Of zipfile and zlib, in a dozen kinds.
            raise InputError(f"is damaged: {printable(member.filename)[:80]}: {error}") from None
        if len(content) != member.file_size:
            raise InputError(f"is damaged: {printable(member.filename)[:80]} is cut short")
        yield member.filename, content
