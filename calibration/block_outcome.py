# SPDX-License-Identifier: Apache-2.0
"""How the calibration of one block ended."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from taccel_lab.report.page import Page


class BlockState(StrEnum):
    """How the calibration of a block ended."""

    DONE = "done"
    SKIPPED = "skipped"
    """There are no captures for it."""
    BLOCKED = "blocked"
    """The check of the captures found that they cannot be used for it."""
    REFUSED = "refused"
    """The calibration found that they cannot."""


@dataclass(frozen=True)
class BlockOutcome:
    """How the calibration of one block ended."""

    name: str
    state: BlockState
    message: str
    """The verdict, or the reason why the block is as before."""
    seconds: float = 0.0
    page: Page | None = None
    """Report of a block that is done; pictures are drawn when it is written. None where an earlier
    run wrote it."""
    written: Path | None = None
    """Folder of the report where it has been written."""

    @property
    def is_unfit(self) -> bool:
        """Whether there are captures for the block and they cannot be used."""
        return self.state in (BlockState.BLOCKED, BlockState.REFUSED)

    def figures(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "name": self.name,
            "state": str(self.state),
            "message": self.message,
            "seconds": self.seconds,
        }
