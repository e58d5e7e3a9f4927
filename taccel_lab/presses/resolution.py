# SPDX-License-Identifier: Apache-2.0
"""Resolutions of a press: of the options, finer ones, and that of the press beside it."""

from __future__ import annotations

from dataclasses import dataclass

FINER = 2**0.5
"""Elements along a side over those of the level below."""


@dataclass(frozen=True)
class Resolution:
    """How much finer a press is than the options say."""

    mesh: float
    """Elements along a side over those of the options."""
    dhat: float
    """Contact range over that of the options."""
    steps: float
    """Steps over those of the options."""

    @classmethod
    def of(cls, level: int, remembers: bool = True) -> Resolution:
        """Resolution of a level; 0 is that of the options. Where the path does not matter
        (``remembers`` is False) finer levels keep its steps."""
        steps = 2.0**level if remembers or level < 0 else 1.0
        return cls(FINER**level, 2.0**-level, steps)


AS_IT_IS = Resolution.of(0)
BESIDE = Resolution(1 / FINER, 1.0, 1.0)
"""Resolution of the press beside that."""
