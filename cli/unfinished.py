# SPDX-License-Identifier: Apache-2.0
"""Where commands keep the blocks that they have finished, so that the same command goes on."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


@contextmanager
def kept_blocks(console: Console, folder: Path) -> Iterator[Path]:
    """The place beside ``folder``; whoever interrupts learns what is kept there."""
    beside = Path(os.path.abspath(folder))  # "." has no name.
    unfinished = beside.with_name(f"{beside.name}_unfinished")
    try:
        yield unfinished
    except KeyboardInterrupt:
        if unfinished.exists():
            console.print(f"finished blocks are kept: the same command continues in {unfinished}")
        raise
