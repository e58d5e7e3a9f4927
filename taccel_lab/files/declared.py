# SPDX-License-Identifier: Apache-2.0
"""What a file states beside what it holds, compared before anything is unpacked, copied or waited
for: a few kilobytes may state, or name over and over, more than any machine has."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import in_bytes

PACKED_TIMES = 1100
"""Largest ratio of unpacked to packed bytes: deflate's most is 1,032 (zlib, "Technical
Details"); beyond it, they are packed twice or are not there."""


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
