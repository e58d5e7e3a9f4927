# SPDX-License-Identifier: Apache-2.0
"""``2/8``: which part of the work a run takes."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import shown

MOST_SHARDS = 10_000


@dataclass(frozen=True)
class Shard:
    """One of several runs that share the work."""

    number: int
    """Number of this run, from 1."""
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Shard of a text such as ``2/8``; raises InputError."""
        number, slash, count = text.partition("/")
        if not (slash and number.isascii() and number.isdigit() and count.isdigit()):
            raise InputError(
                f"shard {shown(text)} is not understood: a shard is written i/n, such as 2/8"
            )
        if not 1 <= int(number) <= int(count) <= MOST_SHARDS:
            raise InputError(
                f"shard {shown(text)} is not understood: of n shards, 1 to {MOST_SHARDS:,}, i is "
                "one from 1 to n; jobs of a SLURM array: --array=1-n"
            )
        return cls(int(number), int(count))
