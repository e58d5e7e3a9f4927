# SPDX-License-Identifier: Apache-2.0
"""The table of faults, ``faults.toml``."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
KINDS = ("formula", "unit", "axis", "guard", "resume", "state")


@dataclass(frozen=True)
class Fault:
    """A slip, as a change of one text that stands once in a file."""

    id: str
    kind: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    """Files and folders to try in turn, the likeliest first."""

    def planted(self, root: Path) -> str:
        """The file's text with the fault in it; ValueError where the table is out of date."""
        text = (root / self.file).read_text(encoding="utf-8")
        if text.count(self.old) != 1 or self.old == self.new:
            raise ValueError(f"{self.id}: its text stands {text.count(self.old)} times")
        return text.replace(self.old, self.new)


def read_faults() -> list[Fault]:
    """All of them."""
    with (ROOT / "tests" / "mutants" / "faults.toml").open("rb") as file:
        rows = tomllib.load(file)["fault"]
    return [Fault(**{**row, "tests": tuple(row["tests"])}) for row in rows]
