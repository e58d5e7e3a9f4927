# SPDX-License-Identifier: Apache-2.0
"""Where commands keep the blocks that they have finished, so that the same command goes on."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from taccel_lab.errors import keeping


@contextmanager
def kept_blocks(folder: Path) -> Iterator[Path]:
    """The place beside ``folder``; an early end says what is kept there."""
    beside = Path(os.path.abspath(folder))  # "." has no name.
    unfinished = beside.with_name(f"{beside.name}_unfinished")

    def what() -> str:
        kept = f"finished blocks stay in {unfinished}, where the same command continues"
        return kept if unfinished.exists() else ""

    with keeping(what):
        yield unfinished
